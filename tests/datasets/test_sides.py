"""Bodies that cannot be right: the up axis of a folder, swapped names, mirrors, stretched bones, rates that drift."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.clip import ClipRef, Scan
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading
from dancedata.datasets.folder.reader import describe
from dancedata.datasets.folder.up import Stance, wrong_files
from dancedata.formats.bvh.write import motion_bvh
from dancedata.synthetic import synthesise_motion
from tests.core.test_sides import on_the_floor
from tests.core.test_sides import turned as turned_by
from tests.messages import raises_message

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


def write_bvh(path: Path, motion: Motion) -> None:
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
    (write_bvh, {"unit": "m", "up": "z"}, ("x", 0)),
    (write_bvh, {"unit": "m"}, ("x", 180)),
]


@pytest.mark.parametrize(("write", "declared", "turn"), WRONG)
def test_certain_files_decide_for_those_that_show_no_floor(tmp_path, parts, write, declared, turn):
    motions = [turned(part, *turn) for part in parts]
    reader, scan = scan_of(tmp_path, write, motions, **declared)
    assert scan.clips == ()
    assert axes(scan) == [f"c{k:02d}" for k in range(len(parts))]
    assert all("up: " in reject.detail for reject in scan.rejects)
    # By the manifest's word for each file they are read.
    suffix = ".bvh" if write is write_bvh else ".npz"
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


SIDE = {"Left": "Right", "Right": "Left", "L": "R", "R": "L"}
LEG = ("hip", "knee", "ankle", "foot")


@pytest.fixture(scope="module")
def text() -> str:
    """A dance of SMPL's joints, whose names are SMPL's own, in metres."""
    return motion_bvh(synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0])


@pytest.fixture
def bvh(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "dance.bvh"
    path.write_text(text)
    return path


def load(path: Path, declared: dict[str, str] | None = None, **parameters: Any) -> Motion:
    clip = ClipRef("x", path, None, "train", declared=tuple((declared or {}).items()))
    return Folder(**{"unit": "m", **parameters}).load(clip)


def renamed(text: str, joints: tuple[str, ...]) -> str:
    """Swap left and right in the names of some joints; all without any."""
    other = {"left": "right", "right": "left"}
    pattern = rf"\b(left|right)_({'|'.join(joints) or '[a-z]+'})\b"
    return re.sub(pattern, lambda found: f"{other[found[1]]}_{found[2]}", text)


def mirrored(text: str) -> str:
    """Reflect a file across x = 0, names unchanged: as an export with a scale of -1 does."""
    hierarchy, motion = text.split("MOTION")
    channels = [name for found in re.findall(r"CHANNELS \d+ (.*)", hierarchy) for name in found.split()]
    signs = np.array([-1 if name in ("Xposition", "Yrotation", "Zrotation") else 1 for name in channels])
    hierarchy = re.sub(r"OFFSET (\S+)", lambda found: f"OFFSET {-float(found[1])!r}", hierarchy)
    head, rows = motion.strip().splitlines()[:2], motion.strip().splitlines()[2:]
    rows = [show(np.array(row.split(), float) * signs) for row in rows]
    return hierarchy + "\n".join(["MOTION", *head, *rows]) + "\n"


def show(row: Any) -> str:
    return " ".join(f"{value:.6f}" for value in row)


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: renamed(text, ()),
        mirrored,
        lambda text: renamed(text, LEG),
        lambda text: renamed(text, ("collar", "shoulder", "elbow", "wrist", "hand")),
    ],
)
def test_swapped_sides(bvh: Path, text: str, edit: Any) -> None:
    bvh.write_text(edit(text))
    with raises_message(DataError, "correct", where="dance.bvh", reason="swapped_sides"):
        load(bvh)


def test_a_joint_map_that_swaps_the_legs(bvh: Path) -> None:
    legs = {f"{one}_{j}": f"{other}_{j}" for j in LEG for one, other in (("left", "right"), ("right", "left"))}
    with raises_message(DataError, "correct", where="dance.bvh", reason="swapped_sides"):
        load(bvh, joint_map=legs)
    # Toes that are not mapped have a place of SMPL's, and say nothing.
    with raises_message(DataError, "correct", where="dance.bvh", reason="swapped_sides"):
        load(bvh, joint_map={**legs, "left_foot": "", "right_foot": ""})


def test_a_mirrored_file_whose_names_are_swapped_is_a_dance(bvh: Path, text: str) -> None:
    plain = load(bvh).joints()
    bvh.write_text(renamed(mirrored(text), ()))
    motion = load(bvh)
    pairs = np.arange(24)
    for left, right in motion.skeleton.pairs:
        pairs[left], pairs[right] = right, left
    assert np.abs(motion.joints()[:, pairs] * (-1, 1, 1) - plain).max() < 1e-5
    assert implausible_flags(motion) == []


@pytest.mark.parametrize("up", ["z", "-y"])
def test_a_wrong_up_axis_of_a_bvh(bvh: Path, up: Any) -> None:
    with raises_message(DataError, "stand", where="dance.bvh", reason="bad_declaration") as error:
        load(bvh, up=up)
    assert str(error.value.fix).startswith("declare up: y (or")
    # The manifest's word for one file is believed, with a flag that stops strict builds.
    assert "implausible_up" in [flag.kind for flag in implausible_flags(load(bvh, {"up": up}))]


def test_a_body_along_an_axis_that_cannot_be_declared(tmp_path: Path) -> None:
    """No declaration of up makes it stand, so none is wrong: a flag, but the clip is read."""
    motion, path = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0], tmp_path / "a.npz"
    for axis, angle in (("x", -90), ("z", 90), ("z", -90)):
        smpl(path, turned(motion, axis, angle))
        assert "implausible_up" in [flag.kind for flag in implausible_flags(load(path, fps=60, up="y"))]


def test_real_files_with_planted_swaps(shared: Path, tmp_path: Path) -> None:
    files = (("rokoko_jesse_dance", "cm", None), ("cmu_01_01", "cmu", None), ("fair1_dab", "guess", "z"))
    for name, unit, up in files:
        text = (shared / f"realdata/bvh/{name}.bvh").read_text()
        assert implausible_flags(load(shared / f"realdata/bvh/{name}.bvh", unit=unit, up=up)) == []
        path = tmp_path / f"{name}.bvh"
        path.write_text(re.sub(r"(?<=JOINT )(Left|Right|[LR](?=[A-Z]))", lambda found: SIDE[found[1]], text))
        with raises_message(DataError, "correct", reason="swapped_sides"):
            load(path, unit=unit, up=up)


def stretched(text: str, by_m: float) -> str:
    """Give the left elbow position channels, and pull it along its bone by up to `by_m`."""
    hierarchy, motion = text.split("MOTION")
    before, _, after = hierarchy.partition("JOINT left_elbow")
    offset = np.array(re.findall(r"OFFSET (\S+) (\S+) (\S+)", after)[0], float)
    column = sum(int(n) for n in re.findall(r"CHANNELS (\d)", before))
    after = after.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ", 1)
    lines = motion.strip().splitlines()
    rows = np.array([line.split() for line in lines[2:]], float)
    pull = np.where(np.arange(len(rows)) % 10 == 0, by_m, 0)[:, None] * offset / np.linalg.norm(offset)
    rows = np.insert(rows, [column] * 3, offset + pull, axis=1)
    return f"{before}JOINT left_elbow{after}MOTION\n" + "\n".join([*lines[:2], *map(show, rows)]) + "\n"


@pytest.mark.parametrize(("by_m", "flagged"), [(0.064, True), (0.0, False), (0.0005, False)])
def test_bones_that_stretch(bvh: Path, text: str, by_m: float, flagged: bool) -> None:
    rigid = load(bvh)
    bvh.write_text(stretched(text, by_m))
    motion = load(bvh)
    assert np.abs(motion.joints() - rigid.joints()).max() < 1e-5
    assert motion.stretch_m == pytest.approx(by_m, abs=1e-5)
    flags = implausible_flags(motion.with_cache())
    assert [(flag.kind, flag.unit) for flag in flags] == [("stretched_bone", "m")] * flagged
    assert [flag.value for flag in flags] == [pytest.approx(by_m, abs=1e-4)] * flagged


DRIFT = "is near 60: a capture at 60 whose frame time was rounded drifts from its music by"


@pytest.mark.parametrize(
    ("time", "message"),
    [("0.016", f"62.5 FPS {DRIFT} 2.4 s"), ("0.017", f"58.8235 FPS {DRIFT} 1.2 s"), ("0.0160", "62.5 FPS is near 60"),
     *((time, "") for time in ("0.016667", "0.01667", "0.0166833", "0.0333", "0.04", "0.008333", "0.0225"))],
)  # fmt: skip
def test_frame_times_near_a_usual_rate(bvh: Path, text: str, time: str, message: str) -> None:
    bvh.write_text(re.sub(r"Frame Time: \S+", f"Frame Time: {time}", text))
    notes = [note for note in describe(bvh, Reading(Declared(), Declared(unit="m")))[0] if "FPS is near" in note]
    assert len(notes) == bool(message)
    assert all(note.startswith(message) for note in notes)
    declared, *_ = describe(bvh, Reading(Declared(fps="60"), Declared(unit="m")))
    assert not any("FPS is near" in note for note in declared)
