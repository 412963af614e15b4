"""Fixtures for the dataset readers: a tiny AIST++ copy that tests then bend."""

import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.registry import DATASETS
from tests.conftest import Once
from tests.datasets.scans import IGNORED, TEST, TRAIN, UNASSIGNED, VAL
from tests.formats.test_safe_pickle import Call

SEED = 7


class Copy:
    """A folder that is built file by file."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def write(self, file: str, data: bytes) -> Path:
        """Write any file below the root."""
        path = self.root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path

    def song(self, file: str, seconds: float = 3.0) -> Path:
        """Write an audio file: a real wav, or a stand-in, which a scan cannot open."""
        silence = np.zeros((round(8_000 * seconds), 1), np.int16)
        return self.write(file, wav_bytes(silence, 8_000) if file.lower().endswith(".wav") else b"stand-in")


class AistCopy(Copy):
    """AIST++'s official layout."""

    def content(self, n_frames: int = 90, **changes: Any) -> dict[str, Any]:
        """Content of a motion pickle; a change to None removes the key."""
        rng = np.random.default_rng(SEED)
        content: dict[str, Any] = {
            "smpl_poses": rng.normal(0, 0.3, (n_frames, 72)).astype(np.float32),
            "smpl_trans": rng.normal(90, 20, (n_frames, 3)).astype(np.float32),
            "smpl_scaling": np.array([93.75], np.float32),
            "smpl_loss": 1.5,
        }
        content.update(changes)
        return {key: value for key, value in content.items() if value is not None}

    def motion(self, name: str, *, folder: str = "motions", **changes: Any) -> Path:
        """Write one motion pickle."""
        return self.write(f"{folder}/{name}.pkl", pickle.dumps(self.content(**changes)))

    def names(self, file: str, *names: str) -> Path:
        """Write a list of names."""
        return self.write(file, "".join(f"{name}\n" for name in names).encode())


@pytest.fixture
def empty_copy(tmp_path: Path) -> AistCopy:
    """Nothing there yet; the path has a space and letters beyond ASCII."""
    return AistCopy(tmp_path / "мой dänce 舞")


@pytest.fixture
def example(once: Once, tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that copies the example of a dataset into a path with a space and letters beyond ASCII."""

    def copy(name: str) -> Path:
        made = once(f"{name}-example", lambda folder: DATASETS.get(name)().make_example(folder / "source"))
        return shutil.copytree(made / "source", tmp_path / "мой dänce")

    return copy


@pytest.fixture
def source(request: pytest.FixtureRequest, example: Callable[[str], Path]) -> Path:
    """The example of the test's parameter `name`, or of the module's READER."""
    named = "name" in request.fixturenames
    return example(request.getfixturevalue("name") if named else request.module.READER.name)


@pytest.fixture
def official(empty_copy: AistCopy) -> AistCopy:
    """Official layout: one clip of each split, one in none, one on the shipped ignore list."""
    for name in (TRAIN, VAL, TEST, UNASSIGNED, IGNORED):
        empty_copy.motion(name)
    for song in ("mBR2", "mJS3", "mJB2"):
        empty_copy.song(f"wavs/{song}.wav")
    return empty_copy


@pytest.fixture
def unpickled_marker(tmp_path: Path) -> tuple[Path, Callable[[], bytes]]:
    """A file that must never appear, and a pickle that makes it when it is loaded without care."""
    marker = tmp_path / "executed"
    return marker, lambda: pickle.dumps({"smpl_poses": Call(os.system, f"touch '{marker}'")})


class FineCopy(Copy):
    """FineDance's layout."""

    def columns(self, n_frames: int = 90) -> np.ndarray[Any, Any]:
        """Content of a motion file: (T, 315) float32, random rotations."""
        from scipy.spatial.transform import Rotation

        rng = np.random.default_rng(SEED)
        matrices = Rotation.from_rotvec(rng.normal(0, 1, (n_frames * 52, 3))).as_matrix()
        rows = matrices[:, :2].reshape(n_frames, 312)
        return np.concatenate([rng.normal(0, 1, (n_frames, 3)), rows], axis=1).astype(np.float32)

    def motion(self, clip: str, array: Any = None, *, root: str = "") -> Path:
        """Write one motion file."""
        path = self.write(f"{root}motion/{clip}.npy", b"")
        np.save(path, self.columns() if array is None else array, allow_pickle=True)
        return path

    def label(self, clip: str, content: Any) -> Path:
        """Write one label: JSON of anything, or raw bytes."""
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        return self.write(f"label_json/{clip}.json", data)

    def sequence(self, clip: str, style: str = "Popping") -> None:
        """Write motion, music and label of one sequence."""
        self.motion(clip)
        self.song(f"music_wav/{clip}.wav")
        self.label(clip, {"name": "a song", "style1": "Street", "style2": style})


@pytest.fixture
def fine(tmp_path: Path) -> FineCopy:
    """FineDance's layout, nothing there yet; the path has a space and letters beyond ASCII."""
    return FineCopy(tmp_path / "мой dänce 舞")


@pytest.fixture
def finedance(fine: FineCopy) -> FineCopy:
    """Train, a cut beginning, test, ignored, ignored and test, on FineNet's list alone, cross-dancer's 159."""
    for clip in ("001", "004", "063", "116", "120", "130", "159"):
        fine.sequence(clip)
    return fine
