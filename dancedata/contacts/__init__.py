"""Contact rules, one per file: labels of feet on the ground."""
