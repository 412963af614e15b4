"""A dance corpus generated from a seed. The plan, motion and music are synthetic: no captured data."""

from dancedata.synthetic.corpus import synthesise_motion, synthesise_song, write_synthetic

__all__ = ["synthesise_motion", "synthesise_song", "write_synthetic"]
