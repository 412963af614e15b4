"""A synthetic dance corpus generated from a seed: its plan, its dancer and its band; no captured data."""

from dancedata.synthetic.corpus import synthesise_motion, synthesise_song, write_synthetic

__all__ = ["synthesise_motion", "synthesise_song", "write_synthetic"]
