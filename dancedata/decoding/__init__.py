"""Columns of samples, arrays and files back to motions."""
