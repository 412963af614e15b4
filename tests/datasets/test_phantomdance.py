"""The dataset reader phantomdance: folders, axes, rotations in the world, bad files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.errors import DataError, SourceError
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24_EDGE
from dancedata.datasets.phantomdance import BONES, PhantomDance, content_of
from dancedata.synthetic import synthesise_motion
from tests.datasets.scans import load, notes, replaced, splits
from tests.messages import raises_message

READER = PhantomDance

DANCE, _ = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=361)
DANCE = DANCE.resampled(FrameGrid.of(30))


def write(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_scan(source: Path) -> None:
    scan = PhantomDance().scan(source)
    assert list(splits(scan)) == ["dance_001", "dance_002", "dance_003"]
    assert scan.clips[0].audio_path == source / "music" / "dance_001.wav"
    assert "by motion/*.json (3 files; version 1.2 has 260); 3 audio files." in notes(scan)
    assert set(splits(PhantomDance(split="all").scan(source)).values()) == {"all"}


def test_all_in_one_folder(source: Path) -> None:
    for path in [*(source / "motion").iterdir(), *(source / "music").iterdir()]:
        path.rename(source / path.name)
    scan = PhantomDance().scan(source)
    assert len(scan.clips) == 3
    assert not scan.rejects


def test_several_folders(source: Path) -> None:
    (source / "old").mkdir()
    write(source / "old" / "a.json", {})
    with raises_message(SourceError, "folders", where="мой dänce"):
        PhantomDance().scan(source)
    assert len(PhantomDance(music_dir=source / "music").scan(source / "motion").clips) == 3


def test_axes_and_rotations(tmp_path: Path) -> None:
    motion = load(PhantomDance(), write(tmp_path / "a.json", content_of(DANCE)))
    assert (motion.grid.rate, motion.skeleton) == (30, SMPL24_EDGE)
    shift = motion.joints()[:, :1] - DANCE.joints()[:, :1]
    assert np.abs(shift).max() < 1e-6, "the pelvis is where it was"
    np.testing.assert_allclose(motion.joints(), DANCE.joints(), atol=2e-5)


def test_a_turn_to_the_right_in_unity(tmp_path: Path) -> None:
    """In Unity +90 degrees about y turn from +z to +x, the right."""
    world = Rotation.from_euler("y", 90, degrees=True).as_quat()
    content = {
        "bone_name": list(BONES),
        "root_positions": [[1.0, 0.9, 2.0]],
        "rotations": [np.tile(world, (24, 1)).tolist()],
    }
    motion = load(PhantomDance(), write(tmp_path / "a.json", content))
    np.testing.assert_allclose(motion.translation, [[-1.0, 0.9, 2.0]])
    assert not motion.rotations[:, 1:].any(), "no joint turns relative to its parent"
    turn = Rotation.from_rotvec(motion.rotations[0, 0].copy())
    front = turn.apply([0, 0, 1])
    left = turn.apply([1, 0, 0])
    np.testing.assert_allclose(front, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(left, [0, 0, 1], atol=1e-12)


def test_bones_in_another_order_and_the_first_releases_key(tmp_path: Path) -> None:
    content = content_of(DANCE)
    expected = load(PhantomDance(), write(tmp_path / "a.json", content))
    order = list(reversed(range(24)))
    rotations = np.asarray(content["rotations"])[:, order].tolist()
    other = {"name": [BONES[k] for k in order], "root_positions": content["root_positions"], "rotations": rotations}
    np.testing.assert_array_equal(
        load(PhantomDance(), write(tmp_path / "b.json", other)).rotations, expected.rotations
    )
    (tmp_path / "c.json").write_text(json.dumps(content), encoding="utf-8-sig")
    np.testing.assert_array_equal(load(PhantomDance(), tmp_path / "c.json").rotations, expected.rotations)


BAD: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "not an object": ("missing_key", lambda c: [1]),
    "23 bones": ("bad_skeleton", replaced("bone_name", lambda b: b[1:])),
    "other bones": ("bad_skeleton", replaced("bone_name", lambda b: ["Hips", *b[1:]])),
    "names are numbers": ("bad_skeleton", replaced("bone_name", lambda b: 24)),
    "ragged": ("bad_shape", replaced("rotations", lambda a: [a[0], a[1][:3]])),
    "text": ("bad_shape", replaced("root_positions", lambda a: [["x", "y", "z"]])),
    "w first": ("bad_axes", replaced("rotations", lambda a: np.roll(a, 1, axis=2).tolist())),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path: Path, name: str) -> None:
    reason, change = BAD[name]
    path = write(tmp_path / "a.json", change(content_of(DANCE)))
    with raises_message(DataError, "R_Hip|download|root_positions|upright", reason=reason):
        load(PhantomDance(), path)
