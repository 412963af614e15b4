"""Representations: they turn motion into the columns of a trainer. One file, one representation."""
