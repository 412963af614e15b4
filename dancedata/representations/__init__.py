"""Motion as the columns of a trainer, and back. One file per representation."""
