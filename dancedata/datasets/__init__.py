"""Dataset readers: a folder of somebody's files becomes clips in canonical form. One file, one dataset."""
