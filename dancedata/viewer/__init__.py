"""Clips as drawings: what the viewer, the report, videos and notebooks show of a clip, and the page that plays it."""

from dancedata.viewer.figure import Figure
from dancedata.viewer.scenes import Flag, Item, Scene, Scenes

__all__ = ["Figure", "Flag", "Item", "Scene", "Scenes"]
