"""The values of a sample beside its arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dancedata.readers.augmenting import Augmenter
from dancedata.readers.batch_reader import Request
from dancedata.store.dataset import Store
from dancedata.store.window_list import WindowList


def metadata(
    store: Store, windows: WindowList, split: str, request: Request, augmenter: Augmenter
) -> dict[str, list[Any]]:
    """Return lists of values by name, one entry per window, in the order of a sample's keys."""
    chosen, epoch = np.asarray(request.places, dtype=np.int64), request.epoch
    mirrored = zip(request.places, request.mirrored, strict=True)
    dropped = [augmenter.dropped(epoch, place) for place in request.places] if augmenter.droppable else []
    clips = [windows.clip_ids[number] for number in windows.clip[chosen].tolist()]
    known = {clip: store.clip(clip) for clip in set(clips)}
    records = [known[clip] for clip in clips]
    numbers = store.meta.get("genre_ids", {})
    return {
        "clip": clips,
        "start": (windows.start[chosen] + np.asarray(request.shifts, dtype=np.int64)).tolist(),
        "length": windows.length[chosen].tolist(),
        "split": [split] * len(clips),
        "genre": [record.genre for record in records],
        "genre_id": [int(numbers.get(record.genre, -1)) for record in records],
        "music": [record.music for record in records],
        "dancer": [record.dancer for record in records],
        "tempo_bpm": [math.nan if r.tempo_bpm is None else float(r.tempo_bpm) for r in records],
        "mirrored": [bool(flag) or augmenter.mirrored(epoch, place) for place, flag in mirrored],
        **{f"{name}_dropped": [name in found for found in dropped] for name in augmenter.droppable},
        "index": [int(place) for place in request.places],
    }
