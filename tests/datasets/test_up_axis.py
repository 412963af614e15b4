"""The up axis of a folder is judged over all its files; bodies that lie for a whole clip are noted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.clip import Scan
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.up import Stance, wrong_files
from dancedata.formats.bvh.write import motion_bvh
from dancedata.synthetic import synthesise_motion
from tests.core.test_sides import on_the_floor
from tests.core.test_sides import turned as turned_by

#: Seconds of the cuts: long ones show a floor, short ones may not.
CUTS = (0.5, 0.5, 1, 1, 1.5, 4)


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gHO_sBM_cAll_d20_mHO3_ch05", n_frames=900)[0]


@pytest.fixture(scope="module")
def parts(dance: Motion) -> list[Motion]:
    starts = np.linspace(0, 600, len(CUTS)).astype(int)
    return [cut(dance, start, int(length * 60)) for start, length in zip(starts, CUTS, strict=True)]


def cut(motion: Motion, start: int, n: int) -> Motion:
    part = slice(start, start + n)
    return Motion(motion.translation[part], motion.rotations[part], motion.grid, motion.skeleton)


def turned(motion: Motion, axis: str, degrees: float) -> Motion:
    return turned_by(motion, Rotation.from_euler(axis, degrees, degrees=True))


def amass(path: Path, motion: Motion) -> None:
    """SMPL-X's 165 columns and AMASS's key for the rate, by which +Z is up."""
    poses = np.pad(motion.rotations.reshape(motion.n_frames, -1)[:, :66], ((0, 0), (0, 99)))
    np.savez(path.with_suffix(".npz"), poses=poses, trans=motion.translation, mocap_frame_rate=60)


def smpl(path: Path, motion: Motion) -> None:
    np.savez(path.with_suffix(".npz"), poses=motion.rotations.reshape(-1, 72), trans=motion.translation)


def bvh(path: Path, motion: Motion) -> None:
    path.with_suffix(".bvh").write_text(motion_bvh(motion))


def scan_of(folder: Path, write: Any, motions: list[Motion], **declared: Any) -> tuple[Folder, Scan]:
    for k, motion in enumerate(motions):
        write(folder / f"c{k:02d}", motion)
    reader = Folder(**{"music": "optional", **declared})
    return reader, reader.scan(folder)


def axes(scan: Scan) -> list[str]:
    return [reject.clip for reject in scan.rejects if reject.reason in ("bad_declaration", "undeclared")]


WRONG: list[tuple[Any, dict[str, str], tuple[str, float]]] = [
    (amass, {}, ("x", 0)),  # +Y up, as BEAT2 and EMAGE write it
    (smpl, {"fps": "60", "unit": "m", "up": "z"}, ("x", 0)),
    (smpl, {"fps": "60", "unit": "m", "up": "y"}, ("x", 90)),
    (smpl, {"fps": "60", "unit": "m", "up": "y"}, ("x", 180)),
    (bvh, {"unit": "m", "up": "z"}, ("x", 0)),
    (bvh, {"unit": "m"}, ("x", 180)),
]


@pytest.mark.parametrize(("write", "declared", "turn"), WRONG)
def test_certain_files_decide_for_those_that_show_no_floor(tmp_path, parts, write, declared, turn):
    motions = [turned(part, *turn) for part in parts]
    reader, scan = scan_of(tmp_path, write, motions, **declared)
    assert scan.clips == ()
    assert axes(scan) == [f"c{k:02d}" for k in range(len(parts))]
    assert all("up: " in reject.detail for reject in scan.rejects)
    # By the manifest's word for each file they are read.
    suffix = ".bvh" if write is bvh else ".npz"
    up = "y" if turn[1] == 0 else "z" if turn[1] == 90 else "-y"
    rows = [f"c{k:02d}{suffix},{up}" for k in range(len(parts))]
    (tmp_path / "manifest.csv").write_text("\n".join(["motion,up", *rows]) + "\n")
    assert len(reader.scan(tmp_path).clips) == len(parts)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_body_that_lies_in_one_short_file_is_noted(tmp_path: Path, dance: Motion, axis: str) -> None:
    reader, scan = scan_of(tmp_path, smpl, [turned(cut(dance, 0, 20), axis, 90)], fps="60", unit="m", up="y")
    assert axes(scan) == []
    (clip,) = scan.clips
    assert {flag.kind for flag in implausible_flags(reader.load(clip))} & {"lying", "implausible_up"}


def test_upright_dances_and_one_who_lies(tmp_path: Path, parts: list[Motion]) -> None:
    """Of a folder that stands, a dancer who lies is left in, with a flag; the others have none."""
    motions = [*parts, on_the_floor(parts[-1], (-np.pi / 2, 0, 0))]
    reader, scan = scan_of(tmp_path, smpl, motions, fps="60", unit="m", up="y")
    assert len(scan.clips) == len(motions)
    flags = [{flag.kind for flag in implausible_flags(reader.load(clip))} for clip in scan.clips]
    assert flags == [*[set()] * len(parts), {"lying"}]


def test_a_few_wrong_files_among_many_that_stand(tmp_path: Path, dance: Motion) -> None:
    """Those that lie as a certain one does are wrong, too; those that stand are not."""
    standing = [cut(dance, 20 * k, 240) for k in range(6)]
    wrong = [turned(part, "x", 90) for part in (cut(dance, 0, 240), cut(dance, 300, 30))]
    _, scan = scan_of(tmp_path, smpl, [*standing, *wrong], fps="60", unit="m", up="y")
    assert axes(scan) == ["c06", "c07"]
    assert len(scan.clips) == 6


@pytest.mark.parametrize(
    ("certain", "lying", "expected"),
    [
        ([0, 0], [True, True], 0),  # two who lie may be dancers
        ([0, 0, 0], [True, True, True], 3),
        ([0, 0, 0, 0], [True, True, True, False], 0),
        ([1, 0, 0, 0], [False, True, True, True], 0),  # one that stands says that the axis is right
        ([-1, 0, 0], [True, True, False], 3),
        ([1, 1, -1, 0, 0], [False, False, True, True, False], 2),
    ],
)
def test_who_decides(certain: list[int], lying: list[bool], expected: int) -> None:
    down, up = np.array([0.0, 0.1, -0.95]), np.array([0.0, 0.95, 0.1])
    stances = {
        str(k): Stance(down if lies else up, c, lies) for k, (c, lies) in enumerate(zip(certain, lying, strict=True))
    }
    assert len(wrong_files(stances)[0]) == expected


def test_cuts_of_real_dances_with_a_wrong_axis(tmp_path: Path, shared: Path) -> None:
    """33 cuts of AIST++ with +Y up and AMASS's key: none is left to lie (`benchmarks/up_axis.py` has more)."""
    import pickle

    motions = []
    grid = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=2)[0]
    for path in sorted((shared / "realdata/aistpp/motions").glob("*.pkl")):
        arrays = pickle.loads(path.read_bytes())  # noqa: S301 - the project's own files
        rotations = arrays["smpl_poses"].reshape(-1, 24, 3).astype(np.float64)
        dance = Motion(arrays["smpl_trans"] / arrays["smpl_scaling"], rotations, grid.grid, grid.skeleton)
        for n in (90, 180, 300, 600):
            starts = np.linspace(0, dance.n_frames - n, min(3, dance.n_frames // n)) if dance.n_frames >= n else []
            motions += [cut(dance, int(start), n) for start in starts]
    assert len(motions) == 33
    assert axes(scan_of(tmp_path, amass, motions)[1]) == [f"c{k:02d}" for k in range(33)]
