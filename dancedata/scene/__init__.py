"""Clips as drawings, and the page that plays them. Reports, videos and notebooks draw the same values."""

from dancedata.scene.figure import Figure
from dancedata.scene.scene_list import Flag, Item, Scene
from dancedata.scene.scenes import Scenes

__all__ = ["Figure", "Flag", "Item", "Scene", "Scenes"]
