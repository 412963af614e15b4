"""Readers of tests, and builds of their sources."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import dancedata
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24
from dancedata.store import Store, verify_store


class OwnReader(Dataset):
    """A reader of a test."""

    version: ClassVar[int] = 1
    licence: ClassVar[str] = "none"
    citation: ClassVar[str] = "none"

    def make_example(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)


@dataclass(frozen=True)
class Silent(OwnReader):
    """Clips without music, or with one song; dancers of a group are named GROUP_pMEMBER."""

    name: ClassVar[str] = "silent"

    clips: tuple[str, ...] = ("a",)
    n_frames: int = 180
    start: str = "0"
    music: str = "m"

    def scan(self, source: Path) -> Scan:
        song, refs = source / "song.wav", []
        for clip in self.clips:
            group, _, member = clip.rpartition("_p")
            refs.append(
                ClipRef(
                    clip, source / "x.npz", song if song.exists() else None, "train", music=self.music, group=group,
                    audio_start=Fraction(self.start), member=int(member) if group else -1,
                )
            )  # fmt: skip
        return Scan("silent", tuple(refs))

    def load(self, ref: ClipRef) -> Motion:
        n, place = self.n_frames, [0.5 * max(0, ref.member), 0.9, 0.0]
        poses = np.cumsum(np.random.default_rng(0).normal(scale=0.01, size=(n, 24, 3)), axis=0)
        return Motion(np.tile(place, (n, 1)), poses, FrameGrid.of(30), SMPL24)


@pytest.fixture(autouse=True)
def _own_readers(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Register the readers that a module of tests defines."""
    DATASETS.names()
    for reader in vars(request.module).values():
        if isinstance(reader, type) and issubclass(reader, OwnReader) and reader is not OwnReader:
            monkeypatch.setitem(DATASETS._classes, reader.name, reader)


@pytest.fixture
def silent_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A source of `Silent`, which is registered, with an empty folder `rows`."""
    monkeypatch.setitem(DATASETS._classes, "silent", Silent)
    folder = tmp_path / "source"
    (folder / "rows").mkdir(parents=True)
    (folder / "x.npz").write_bytes(b"x")
    return folder


@pytest.fixture
def store_of(tmp_path: Path, cache: Path) -> Callable[..., Store]:
    """Return a function that builds a sound dataset of a document and a source."""

    def run(document: dict[str, Any], source: Path, out: str = "out", **options: Any) -> Store:
        options = {"jobs": 1, "cache": cache, "progress": False, "overwrite": True} | options
        store = dancedata.build(document, source, tmp_path / out, **options).open()
        assert verify_store(store.path) == []
        return store

    return run
