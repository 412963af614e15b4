"""Clips as drawings, and the page that plays them. Reports, videos and notebooks draw the same values."""

from dancedata.viewer.figure import Figure
from dancedata.viewer.scenes import Flag, Item, Scene, Scenes

__all__ = ["Figure", "Flag", "Item", "Scene", "Scenes"]
