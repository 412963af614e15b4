"""Clips as drawings, and the page that plays them. Reports, videos and notebooks draw the same values."""

from dancedata.viewer.figure import Figure
from dancedata.viewer.scene_list import Flag, Item, Scene
from dancedata.viewer.scenes import Scenes

__all__ = ["Figure", "Flag", "Item", "Scene", "Scenes"]
