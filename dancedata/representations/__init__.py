"""Representations: motion becomes a trainer's columns. One file, one representation."""
