"""Copies of train clips: what they are changed by."""
