"""Features of music; each is a package or a module."""
