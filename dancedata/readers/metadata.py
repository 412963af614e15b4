"""The values of a sample beside its arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dancedata.store.dataset import Store
from dancedata.store.window_list import WindowList


def metadata(
    store: Store, windows: WindowList, split: str, places: Sequence[int], mirrored: Sequence[bool]
) -> dict[str, list[Any]]:
    """Return lists of values by name, one entry per window, in the order of a sample's keys.

    Parameters
    ----------
    places, mirrored
        (B,) positions in `windows`, and whether each of them is mirrored.
    """
    chosen = np.asarray(places, dtype=np.int64)
    clips = [windows.clip_ids[number] for number in windows.clip[chosen].tolist()]
    known = {clip: store.clip(clip) for clip in set(clips)}
    records = [known[clip] for clip in clips]
    numbers = store.meta.get("genre_ids", {})
    return {
        "clip": clips,
        "start": windows.start[chosen].tolist(),
        "length": windows.length[chosen].tolist(),
        "split": [split] * len(clips),
        "genre": [record.genre for record in records],
        "genre_id": [int(numbers.get(record.genre, -1)) for record in records],
        "music": [record.music for record in records],
        "dancer": [record.dancer for record in records],
        "tempo_bpm": [math.nan if r.tempo_bpm is None else float(r.tempo_bpm) for r in records],
        "mirrored": [bool(flag) for flag in mirrored],
        "index": [int(place) for place in places],
    }
