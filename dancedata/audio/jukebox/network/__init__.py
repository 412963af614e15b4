"""Jukebox's network: the VQ-VAE's encoder, the top-level prior, and where its blocks are."""
