"""Jukebox's network: the VQ-VAE's encoder, the blocks of the top-level prior, their precision and their memory."""
