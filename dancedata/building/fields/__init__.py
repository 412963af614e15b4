"""Fields: of motion, of music, from files."""
