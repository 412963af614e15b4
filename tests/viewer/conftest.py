"""The datasets of the tests of scenes, and their server."""

from tests.scene.conftest import crowd, crowd_source, dances, duets, lacking, odd, scenes, served, source

__all__ = ["crowd", "crowd_source", "dances", "duets", "lacking", "odd", "scenes", "served", "source"]
