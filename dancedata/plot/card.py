"""card_pictures: the pictures of a dataset's card on a hub."""

from __future__ import annotations

import io
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.kernel import Progress, Store
from dancedata.plot.beat_axes import beats
from dancedata.plot.map_axes import pose_map
from dancedata.plot.motion_axes import motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

#: Dots per inch.
_DPI = 110


def card_pictures(store: Store, progress: Progress) -> dict[str, tuple[str, bytes]]:
    """Return the pictures of a card by file name: description, and PNG; equal datasets give equal bytes.

    UsageError if there is no motion to draw, or if matplotlib is missing.
    """
    drawn, pictures = _drawings(store), {}
    with progress.stage("drawing", len(drawn)) as advance:
        for name, (what, draw) in drawn.items():
            pictures[name] = what, _png(draw())
            advance(1)
    return pictures


def _drawings(store: Store) -> dict[str, tuple[str, Callable[[], Axes]]]:
    """Return name, description and drawing of the pictures; of beats where there is music."""
    clip = next((c.id for c in store if not c.source), "")
    if not clip:
        raise UsageError("a dataset without clips has no card", where=store.path)
    drawings: dict[str, tuple[str, Callable[[], Axes]]] = {
        "poses.png": ("poses of a clip", partial(motion, store, clip, poses=7)),
        "map.png": ("map of the poses along their two largest components", partial(pose_map, store)),
    }
    with suppress(DanceDataError):  # no music
        beats(store, clip)
        drawings["beats.png"] = "speed, key motions and beats of a clip", partial(beats, store, clip)
    return drawings


def _png(axes: Axes) -> bytes:
    data = io.BytesIO()
    axes.figure.savefig(data, format="png", dpi=_DPI, metadata={"Software": None})  # type: ignore[union-attr]
    return data.getvalue()
