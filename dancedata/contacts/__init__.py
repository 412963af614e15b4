"""Contact rules: which feet touch the ground. One file, one rule."""
