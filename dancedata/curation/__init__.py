"""Faults of captured motion: scores of clips and of spans in them, and repairs."""
