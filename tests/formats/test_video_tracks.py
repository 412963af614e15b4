"""One person whom a video program lost and found again under other numbers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder import Folder
from tests.messages import raises_message
from tests.video_files import phalp, wham, wham_person

N = 240


def chunk(whole: dict[str, Any], frames: range, yaw: float = 0.0) -> dict[str, Any]:
    """Return some frames of a person of WHAM, in a world of their own that begins at the origin."""
    part = {name: values[frames.start : frames.stop].copy() for name, values in whole.items()}
    turn, rest = Rotation.from_euler("y", yaw), np.array(SMPL24.offsets[0])
    pelvis = turn.apply(part["trans_world"] + rest)
    part["trans_world"] = pelvis - pelvis[0] * (1, 0, 1) + (0.3, 0.1, 0) - rest
    part["pose_world"][:, :3] = (turn * Rotation.from_rotvec(part["pose_world"][:, :3])).as_rotvec()
    return part


def load(path: Path, **declared: str) -> Motion:
    ref = ClipRef("a", path, None, "train", declared=tuple(sorted(declared.items())))
    return Folder(fps=30, music="optional").load(ref)


@pytest.mark.parametrize("keys", [(0, 4, 17, 31), tuple(np.unique([0, 4, 17, 31])), ("0", "4", "17", "31")])
def test_tracks_of_one_person_are_one_clip(tmp_path: Path, keys: tuple[Any, ...]) -> None:
    whole = wham_person(N, vertices=2)
    spans = (range(60), range(61, 130), range(136, 180), range(180, N))
    parts = [chunk(whole, span, yaw) for span, yaw in zip(spans, (0.0, 1.0, -2.5, 3.0), strict=True)]
    path = tmp_path / "anna.pkl"
    path.write_bytes(wham(dict(zip(keys, parts, strict=True))))
    motion = load(path)
    assert motion.n_frames == N
    (tmp_path / "whole.pkl").write_bytes(wham({0: chunk(whole, range(N))}))
    expected = load(tmp_path / "whole.pkl")
    seen = np.concatenate([np.arange(span.start, span.stop) for span in spans])
    # The body itself is exact; where it goes on, it does so as fast as before.
    np.testing.assert_allclose(motion.rotations[seen, 1:], expected.rotations[seen, 1:], atol=1e-6)
    assert np.abs(motion.joints()[seen] - expected.joints()[seen]).max() < 0.1
    assert np.linalg.norm(np.diff(motion.translation, axis=0), axis=1).max() < 0.1
    assert load(path, person=str(keys[2])).n_frames == spans[2].stop  # one track, by its number
    (clip,) = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert clip.id == "anna"
    assert "0, 4, 17, 31" in " ".join(clip.notes)


def _source(path: Path) -> Path:
    source = path.parent / "source"
    (source / "motions").mkdir(parents=True)
    (source / "motions" / path.name).write_bytes(path.read_bytes())
    return source


def other(part: dict[str, Any], what: str) -> dict[str, Any]:
    if what == "another pose":
        part["pose"][:, 3:] += 1.2
        part["pose_world"][:, 3:] += 1.2
    elif what == "another place":
        part["trans"] += (2, 0, 0)
    elif what == "much later":
        part["frame_ids"] += 20
    elif what == "at the same time":
        part["frame_ids"] -= 5
    return part


@pytest.mark.parametrize("what", ["another pose", "another place", "much later", "at the same time"])
def test_other_people_are_not_joined(tmp_path: Path, what: str) -> None:
    whole = wham_person(N, vertices=2)
    path = tmp_path / "two.pkl"
    path.write_bytes(wham({1: chunk(whole, range(100)), 2: other(chunk(whole, range(101, N)), what)}))
    with raises_message(DataError, "split", where="two.pkl", reason="several_people"):
        load(path)
    clips = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert [clip.id for clip in clips] == ["two-person1", "two-person2"]


def test_two_dancers_of_whom_one_is_lost(tmp_path: Path) -> None:
    anna, ben = wham_person(N, vertices=2), wham_person(N, seed=5, vertices=2)
    ben["trans"] = ben["trans"] + np.float32([3, 0, 0])
    path = tmp_path / "duet.pkl"
    path.write_bytes(wham({0: chunk(anna, range(90)), 1: ben, 7: chunk(anna, range(93, N))}))
    folder = Folder(fps=30, music="optional", people="split")
    clips = folder.scan(_source(path)).clips
    assert [clip.id for clip in clips] == ["duet-person0", "duet-person1"]
    assert [folder.load(clip).n_frames for clip in clips] == [N, N]


def test_two_tracks_that_go_on_in_the_same_one_are_left(tmp_path: Path) -> None:
    whole = wham_person(N, vertices=2)
    path = tmp_path / "three.pkl"
    path.write_bytes(
        wham({0: chunk(whole, range(90)), 1: chunk(whole, range(20, 91)), 2: chunk(whole, range(95, N))})
    )
    clips = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert len(clips) == 3


def test_tracks_of_phalp(tmp_path: Path) -> None:
    from tests.video_files import dance

    rotations, path_of = dance(60)
    people = {3: (rotations[:30], path_of[:30], np.arange(30)), 8: (rotations[33:], path_of[33:], np.arange(33, 60))}
    path = tmp_path / "demo.pkl"
    path.write_bytes(phalp(people))
    assert load(path).n_frames == 60
