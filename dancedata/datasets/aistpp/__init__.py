"""AIST++ (Li et al. 2021): layout, names, splits, motion pickles."""

from dancedata.datasets.aistpp.reader import AistPP

__all__ = ["AistPP"]
