"""Files on disk: written whole, locked, published as folders, read strictly."""
