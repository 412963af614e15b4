"""Copies of clips that a dance allows: its mirror image."""
