"""Clips and features as figures for papers and as videos. matplotlib is loaded when it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "beats",
    "card_pictures",
    "features",
    "motion",
    "pose_map",
    "write_page",
    "write_video",
]

if TYPE_CHECKING:
    from dancedata.plot.beat_axes import beats
    from dancedata.plot.card import card_pictures
    from dancedata.plot.feature_axes import features
    from dancedata.plot.map_axes import pose_map
    from dancedata.plot.motion_axes import motion
    from dancedata.plot.video import write_video
    from dancedata.scene.motion_page import write_page
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "plot.beat_axes": "beats",
            "plot.card": "card_pictures",
            "plot.feature_axes": "features",
            "plot.map_axes": "pose_map",
            "plot.motion_axes": "motion",
            "plot.video": "write_video",
            "scene.motion_page": "write_page",
        },
    )
