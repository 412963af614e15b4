"""Core types and pure functions of arrays. Everything else is built on these; they import nothing of ours."""
