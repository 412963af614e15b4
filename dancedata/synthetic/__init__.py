"""A synthetic dance corpus made from a seed: its plan, its dancer and its band. Nothing in it was captured."""

from dancedata.synthetic.corpus import synthesise_motion, synthesise_song, write_synthetic

__all__ = ["synthesise_motion", "synthesise_song", "write_synthetic"]
