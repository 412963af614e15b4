"""Offsets between the music and the motion of a source."""
