"""A synthetic dance corpus generated from a seed: its plan, motion and music; no captured data."""

from dancedata.synthetic.corpus import synthesise_motion, synthesise_song, write_synthetic

__all__ = ["synthesise_motion", "synthesise_song", "write_synthetic"]
