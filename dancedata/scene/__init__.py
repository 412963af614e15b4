"""Clips as drawings: what the viewer, the report, videos and notebooks show of a clip, and the page that plays it."""

from dancedata.scene.figure import Figure
from dancedata.scene.scenes import Flag, Item, Scene, Scenes

__all__ = ["Figure", "Flag", "Item", "Scene", "Scenes"]
