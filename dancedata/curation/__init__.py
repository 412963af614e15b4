"""Faults of motion: scores of clips and spans, and repairs."""
