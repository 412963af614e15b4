"""Motorica Dance (Alexanderson et al. 2023): motion capture of eight genres, 6 hours, 120 FPS.

The files: docs/datasets/motorica.md, and `labels` for Motorica++. LDA's features are not read.
"""

from dancedata.datasets.motorica.reader import Motorica

__all__ = ["Motorica"]
