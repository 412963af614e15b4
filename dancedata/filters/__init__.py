"""Which windows of a dataset are kept."""
