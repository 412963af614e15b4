"""Stores that the readers' tests read."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.beats import Beats
from dancedata.audio.beats.track import BeatTrack
from dancedata.audio.librosa35 import Librosa35
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.grid import FrameGrid
from dancedata.store.dataset import Store, open_store
from dancedata.store.schema import Field
from dancedata.store.stored_clip import AudioBlock, StoredClip
from dancedata.store.writer import write_store
from dancedata.testing.stores import random_fields, write_random_store
from tests.groups_store import HEADER, SIZES, stored


def _lodge_fields() -> tuple[Field, ...]:
    (plain,) = random_fields({"lodge139": 139}, {})
    groups = (Group("contact", 4, "1"), Group("translation", 3, "m"), Group("rotation_6d", 132, "1"))
    key = (Group("speed", 1, "m"), Group("minimum", 1, "1"), Group("prominence", 1, "m"))
    return (
        replace(plain, columns=Columns(groups, plain.columns.mirror)),
        Field("lodge", "keymotion", Columns(key, Mirror((0, 1, 2), (1,) * 3)), Fraction(30)),
        *random_fields({}, {"librosa35": 35}),
    )


#: Lodge's columns and key motions, and librosa35.
LODGE = _lodge_fields()


def rewritten(folder: Path, change: Callable[[StoredClip], StoredClip], **options: Any) -> Store:
    """A store in FOLDER/out: train clips of 90 frames, windows of 30, each clip changed before it is stored."""
    options = {"clips": {"train": 4}, "n_frames": (90, 90), "length": 30, "stride": 30, **options}
    made = write_random_store(folder / "plain", **options)
    (folder / "out").mkdir()
    write_store(folder / "out", made.header, list(map(change, made.clips)), shard_bytes=1 << 19)
    return open_store(folder / "out")


@pytest.fixture(scope="session")
def store_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of track scope: 22 x 141 = 3,102 train windows of 150 frames, in several shards."""
    out = tmp_path_factory.mktemp("readers") / "store"
    clips = {"train": 22, "val": 2, "test": 2}
    write_random_store(out, clips=clips, n_frames=(290, 290), length=150, stride=1)
    return out


@pytest.fixture(scope="session")
def groups_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Groups of two to five dancers, in several shards."""
    out = tmp_path_factory.mktemp("groups")
    write_store(out, HEADER, stored(SIZES), shard_bytes=300_000)
    return open_store(out)


@pytest.fixture(scope="session")
def mixed_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Five train clips of 200 frames in several shards: Lodge's columns and key motions, 60 rows per second, halves.

    Windows of 40 frames every 10.
    """
    folder = tmp_path_factory.mktemp("mixed")
    (fast,) = random_fields({"fast": 21}, {}, fast=60)
    (half,) = random_fields({}, {"half": 64})
    lodge, key, music = LODGE
    fields = (lodge, replace(fast, dtype="float16"), key, music, replace(half, dtype="float16"))

    def change(clip: StoredClip) -> StoredClip:
        rows = {name: np.array(array) for name, array in clip.motion.items()}
        rows["lodge"][:, 1] = np.arange(len(rows["lodge"])) % 9 == 4
        return replace(clip, motion=rows)

    clips = {"train": 5, "val": 1}
    return rewritten(folder, change, clips=clips, n_frames=(200, 200), length=40, stride=10, fields=fields)


@pytest.fixture(scope="session")
def beats_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Five train clips of 300 frames with beats in bars of four, other beats in librosa35, and a field of 60 rows."""
    folder = tmp_path_factory.mktemp("beats")
    motion, fast, librosa35 = random_fields({"edge151": 151, "fast": 21}, {"librosa35": 35}, fast=60)
    fields = (
        *(motion, fast, replace(librosa35, columns=Librosa35().columns)),
        Field("beats", "audio", Beats().columns, Fraction(30)),
    )

    def change(clip: StoredClip) -> StoredClip:
        return replace(clip, audio={name: _with_beats(name, block) for name, block in clip.audio.items()})

    clips = {"train": 5, "val": 1}
    return rewritten(folder, change, clips=clips, n_frames=(300, 300), length=120, stride=15, fields=fields)


def _with_beats(field: str, block: AudioBlock) -> AudioBlock:
    """Replace random rows of a song by beats, every 14 to 20 rows; those of librosa35 are 3 rows late."""
    n_rows, period = len(block.array), 14 + int(block.key.encode().hex(), 16) % 7
    beats = np.arange(5, n_rows - 5, period)
    rows = BeatTrack(beats, beats // period % 4 == 1, FrameGrid.of(30)).rows(n_rows, FrameGrid.of(30))
    if field == "librosa35":
        late = np.zeros((n_rows, 35), dtype=np.float32)
        late[beats + 3, 34] = 1
        rows = late
    return replace(block, array=rows)
