"""Where the parts of a build meet: files that are exchanged meanwhile, groups by name, dancers that are left out."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.files.regular_file import sha256_file
from dancedata.store import Store
from tests.building.conftest import OwnReader
from tests.messages import raises_message

COPIES = {"mirror": True, "yaw": {}, "root_offset": {}, "noise": {}}
ROWS = {"path": "{clip}_rows.npy", "rate": 30, "columns_per_row": 3, "tolerance_s": None}


@dataclass(frozen=True)
class Troupe(OwnReader):
    """Translations NAME.npy at 60 FPS, and NAME.wav; groups are told by `groups`, not by files."""

    name: ClassVar[str] = "troupe"
    groups: ClassVar[dict[str, str]] = {}
    starts: ClassVar[dict[str, Fraction]] = {}
    before_load: ClassVar[Callable[[], None]] = staticmethod(lambda: None)

    def scan(self, source: Path) -> Scan:
        paths = sorted(path for path in source.glob("*.npy") if "_rows" not in path.stem)
        refs = []
        for path in paths:
            group = self.groups.get(path.stem, "")
            member = [p.stem for p in paths if self.groups.get(p.stem) == group].index(path.stem) if group else -1
            start = self.starts.get(path.stem, Fraction(0))
            refs.append(ClipRef(path.stem, path, path.with_suffix(".wav"), "train", music=group or path.stem,
                                group=group, member=member, audio_start=start))  # fmt: skip
        return Scan("troupe", tuple(refs))

    def load(self, ref: ClipRef) -> Motion:
        type(self).before_load()
        translation = np.load(ref.motion_path)
        return Motion(translation, np.zeros((len(translation), 24, 3)), FrameGrid.of(60), SMPL24)


def write(folder: Path, name: str, seed: int, n_frames: int = 180, spike: float = 0) -> None:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    translation = np.cumsum(rng.normal(scale=0.001, size=(n_frames, 3)), axis=0)
    translation += np.array([seed, 1, 0])
    translation[n_frames // 2, 0] += spike
    np.save(folder / f"{name}.npy", translation)
    np.save(folder / f"{name}_rows.npy", rng.normal(size=(n_frames // 2, 3)).astype(np.float32))
    soundfile.write(folder / f"{name}.wav", rng.normal(scale=0.1, size=n_frames * 200), 12_000)


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Clips a and b."""
    for name in ("groups", "starts", "before_load"):
        monkeypatch.setattr(Troupe, name, getattr(Troupe, name) if name == "before_load" else {})
    for seed, name in enumerate("ab"):
        write(tmp_path / "source", name, seed)
    return tmp_path / "source"


@pytest.fixture
def build(source: Path, tmp_path: Path) -> Callable[..., Store]:
    """Return a function: build with other keys and a cache by name."""

    def build(cache: str, **keys: Any) -> Store:
        document = {
            "recipe": 1, "name": "joints", "dataset": {"troupe": {}}, "fps": 30,
            "windows": {"length_s": 1, "stride_s": 0.5}, "motion": {"edge151": {}, "joints": {}}, "audio": {},
        } | keys  # fmt: skip
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        built = dancedata.build(document, source, tmp_path / "out", jobs=1, cache=tmp_path / cache, progress=False)
        return built.open()

    return build


def hashes(store: Store) -> dict[str, str]:
    return {path.name: sha256_file(path) for path in sorted(store.path.iterdir())}


@pytest.mark.parametrize("kind", [".npy", ".wav", "_rows.npy"])
@pytest.mark.parametrize("n_loads", [1, 3])
def test_a_file_that_is_exchanged_meanwhile_is_told_and_leaves_nothing_behind(
    build, source, tmp_path, monkeypatch, kind: str, n_loads: int
) -> None:
    """While motion is measured, and while it is encoded; with the first file back, all is as if it had not been."""
    audio = {"librosa35": {}, "file.rows": ROWS}
    clean = hashes(build("clean", audio=audio))
    write(tmp_path / "other", "b", 9, n_frames=240)
    file, aside = source / f"b{kind}", tmp_path / "aside"
    calls = iter(range(100))

    def exchange() -> None:
        if next(calls) + 1 == n_loads:
            file.rename(aside)
            shutil.copy(tmp_path / "other" / file.name, file)

    monkeypatch.setattr(Troupe, "before_load", staticmethod(exchange))
    assert {(r["reason"], r["clip"]) for r in build("cache", audio=audio).rejects} >= {("changed", "b")}
    monkeypatch.setattr(Troupe, "before_load", staticmethod(lambda: None))
    aside.replace(file)
    assert hashes(build("cache", audio=audio)) == clean


@pytest.mark.parametrize(("before", "after"), [
    ({}, {"a": "g", "b": "g"}), ({"a": "g", "b": "g"}, {"a": "h", "b": "h"}),
])  # fmt: skip
def test_copies_of_a_group_of_another_name_are_their_own(build, before, after):
    Troupe.groups.update(before)
    build("shared", augment=COPIES)
    Troupe.groups.clear()
    Troupe.groups.update(after)
    assert hashes(build("shared", augment=COPIES)) == hashes(build("clean", augment=COPIES))


@pytest.mark.parametrize("groups", [{}, {"a": "g", "b": "g__mirror"}])
def test_a_copy_with_the_name_of_a_clip_or_a_group_is_an_error(build, source: Path, groups: dict[str, str]) -> None:
    Troupe.groups.update(groups)
    write(source, "a__mirror" if not groups else "c", 3)
    with raises_message(SourceError, "same", where="__mirror"):
        build("cache", augment={"mirror": True})


def test_a_clip_that_is_left_out_whole_has_no_rejects_of_windows(build, source: Path) -> None:
    write(source, "b", 1, spike=0.3)
    Troupe.starts["b"] = Fraction(1)
    store = build("cache", audio={"librosa35": {}}, rules={"curate": {"spikes": {"leave_out": "clip"}}})
    assert [(r["reason"], r["clip"], r.get("window")) for r in store.rejects] == [("curated", "b", None)]


def test_slices_have_no_copies_at_another_speed(build) -> None:
    """Which slice of the stretched song it would be is not known."""
    with raises_message(UsageError, "speed", where="augment.tempo"):
        build(
            "cache",
            transforms=[{"slices": {"length_s": 1, "stride_s": 0.5}}],
            augment={"tempo": {"speeds": [0.5]}},
            audio={"librosa35": {}},
        )
