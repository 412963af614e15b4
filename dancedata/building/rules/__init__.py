"""Window rules: plug-ins, one file each."""
