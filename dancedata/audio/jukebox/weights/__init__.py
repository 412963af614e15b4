"""Jukebox's weights: how they are downloaded, which tensors they hold, and how these are loaded."""
