"""Segments: listed, written, replaced, and found in motion."""
