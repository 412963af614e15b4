"""Clips as figures for papers and as videos. matplotlib and Pillow are loaded when they are used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["features", "motion", "write_page", "write_video"]

if TYPE_CHECKING:
    from dancedata.plot.motion_axes import features, motion
    from dancedata.plot.video import write_video
    from dancedata.viewer.notebook import write_page
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "features": "dancedata.plot.motion_axes",
            "motion": "dancedata.plot.motion_axes",
            "write_page": "dancedata.viewer.notebook",
            "write_video": "dancedata.plot.video",
        },
    )
