"""FineDance (Li et al. 2023): layout, labels, splits, motion arrays."""

from dancedata.datasets.finedance.reader import FineDance

__all__ = ["FineDance"]
