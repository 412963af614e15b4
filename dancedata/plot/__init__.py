"""Clips and features as figures for papers and as videos. matplotlib is loaded when it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "beats",
    "card_pictures",
    "compare",
    "features",
    "motion",
    "paths",
    "pose_map",
    "write_page",
    "write_video",
]

if TYPE_CHECKING:
    from dancedata.plot.beat_axes import beats
    from dancedata.plot.card import card_pictures
    from dancedata.plot.compare_axes import compare
    from dancedata.plot.feature_axes import features
    from dancedata.plot.map_axes import pose_map
    from dancedata.plot.motion_axes import motion
    from dancedata.plot.path_axes import paths
    from dancedata.plot.video import write_video
    from dancedata.scene.motion_page import write_page
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "beats": "dancedata.plot.beat_axes",
            "card_pictures": "dancedata.plot.card",
            "compare": "dancedata.plot.compare_axes",
            "features": "dancedata.plot.feature_axes",
            "motion": "dancedata.plot.motion_axes",
            "paths": "dancedata.plot.path_axes",
            "pose_map": "dancedata.plot.map_axes",
            "write_page": "dancedata.scene.motion_page",
            "write_video": "dancedata.plot.video",
        },
    )
