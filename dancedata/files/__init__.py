"""Files on disk: written whole, locked, read strictly. `publish` replaces folders as a whole."""
