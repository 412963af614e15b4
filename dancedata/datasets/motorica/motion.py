"""One BVH file of Motorica -> canonical motion; and a synthetic source in its layout."""

import hashlib
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import MOTORICA21
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_rotvec
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed
from dancedata.formats.bvh.parse import Bvh, read_bvh, read_bvh_header
from dancedata.formats.bvh.write import write_bvh

RATE = 120
#: The published frame time is 0.008333 s; one within this distance of 1/120 s is 1/120 s.
_SNAP_S = Fraction(1, 100_000)
_PUBLISHED = "use the published file; other captures are read by the dataset folder"
#: Bounds of the length of a leg (thigh and shin), metres: a check of the unit.
_LEG_M = (0.5, 1.2)

Floats = NDArray[np.float64]


def seconds_of(path: Path) -> Fraction | None:
    """Return the duration by the file's header; None if it cannot be read, which loading reports."""
    try:
        return Fraction(read_bvh_header(path).n_frames, RATE)
    except DataError:
        return None


def load_motion(path: Path, *, fingers: bool, start: Fraction | None = None, end: Fraction | None = None) -> Motion:
    """Read a recording from `start` to `end`, seconds: 120 FPS, metres, +Y up, the file's own joints and bones."""
    bvh = read_bvh(path)
    _check_rate(bvh)
    kept = _joints(bvh, fingers)
    skeleton = _skeleton(bvh, kept)
    first, stop = (int((start or 0) * RATE), bvh.n_frames if end is None else int(end * RATE))
    if not 0 <= first < min(stop, bvh.n_frames):
        raise DataError("no frame of the recording is left", reason="too_short", where=str(path),
                        found=f"{bvh.n_frames} frames, of which {first} to {stop} are asked for",
                        fix="set trim_s: 0, or leave the recording out")  # fmt: skip
    values = bvh.values[first:stop]
    columns = bvh.joints[kept[0]].position_columns
    root = values[:, [columns[axis] for axis in range(3)]] / 100
    return Motion(root, _rotations(bvh, kept, values), FrameGrid.of(RATE), skeleton)


def _check_rate(bvh: Bvh) -> None:
    if abs(Fraction(bvh.frame_time) - Fraction(1, RATE)) >= _SNAP_S:
        raise DataError("the frame time is not Motorica's", reason="bad_rate", where=str(bvh.path),
                        found=f"Frame Time: {bvh.frame_time}",
                        allowed=f"0.008333, which is read as 1/{RATE} s exactly", fix=_PUBLISHED)  # fmt: skip


def _joints(bvh: Bvh, fingers: bool) -> list[int]:
    """Return the indices of the joints to keep; checks names, parents and channels."""
    names = bvh.names
    missing = [name for name in MOTORICA21.joints if name not in names]
    kept = [k for k, name in enumerate(names) if fingers or name in MOTORICA21.joints]
    twins = sorted({names[k] for k in kept if names.count(names[k]) > 1})
    problem = f"no joint {listed(missing)}" if missing else f"several joints named {listed(twins)}" if twins else ""
    for name, parent in zip(MOTORICA21.joints, MOTORICA21.parents, strict=True):
        if not problem:
            above = bvh.joints[names.index(name)].parent
            expected = MOTORICA21.joints[parent] if parent >= 0 else ""
            if (names[above] if above >= 0 else "") != expected:
                problem = (
                    f"the parent of {name} is {names[above] if above >= 0 else 'none'}, not {expected or 'none'}"
                )
    if problem:
        raise DataError("the hierarchy is not Motorica's", reason="bad_skeleton", where=str(bvh.path), found=problem,
                        allowed=f"{', '.join(MOTORICA21.joints[:6])}, ... and fingers", fix=_PUBLISHED)  # fmt: skip
    root = bvh.joints[kept[0]]
    still = [bvh.joints[k].name for k in kept if len(bvh.joints[k].order) != 3]
    if len(root.position_columns) != 3 or still:
        lacks = f"; three rotations lack {listed(still)}" if still else ""
        raise DataError("channels of the hierarchy are missing", reason="missing_channels", where=str(bvh.path),
                        found=f"{root.name}: {' '.join(root.channels)}{lacks}",
                        allowed="three positions for Hips, three rotations for each joint",
                        fix=_PUBLISHED)  # fmt: skip
    return kept


def _skeleton(bvh: Bvh, kept: list[int]) -> Skeleton:
    """Return the file's bones in metres; a digest of them is in the name."""
    names = tuple(bvh.joints[k].name for k in kept)
    parents = (-1, *(kept.index(bvh.joints[k].parent) for k in kept[1:]))
    offsets = np.array([bvh.joints[k].offset for k in kept]) / 100
    offsets[0] = 0  # replaced by the position channels
    leg = sum(float(np.linalg.norm(offsets[names.index(name)])) for name in ("LeftLeg", "LeftFoot"))
    if not _LEG_M[0] <= leg <= _LEG_M[1]:
        raise DataError("the lengths of this file are not centimetres", reason="bad_unit", where=str(bvh.path),
                        found=f"a leg of {leg * 100:.4g} units",
                        allowed=f"{_LEG_M[0] * 100:g} to {_LEG_M[1] * 100:g} cm from hip to ankle",
                        fix=_PUBLISHED)  # fmt: skip
    limbs = [f"{side}{name}" for side in ("Left", "Right") for name in ("Leg", "Foot", "ForeArm", "Hand")]
    lost = [name for name in limbs if not float(np.linalg.norm(offsets[names.index(name)])) > leg / 50]
    if lost:
        raise DataError("bones have no length", reason="bad_skeleton", where=str(bvh.path),
                        found=f"{listed(lost)} at their parents' places", allowed=f"more than {leg * 2:.3g} cm",
                        fix=_PUBLISHED)  # fmt: skip
    pairs = tuple((j, names.index(f"Right{n[4:]}")) for j, n in enumerate(names) if n.startswith("Left"))
    left, right, toe, other_toe = (names.index(MOTORICA21.joints[j]) for j in MOTORICA21.feet)
    digest = hashlib.sha256((np.round(offsets, 5) + 0.0).astype("<f8").tobytes()).hexdigest()[:8]
    name = f"motorica{len(names)}:{digest}"
    return Skeleton(name, names, parents, offsets, pairs, (left, right, toe, other_toe))


def _rotations(bvh: Bvh, kept: list[int], values: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    rotations = np.empty((len(values), len(kept), 3))
    for j, k in enumerate(kept):
        joint = bvh.joints[k]
        # Capitals: each angle about the axes that the one before has turned.
        turned = Rotation.from_euler(joint.order, values[:, joint.rotation_columns], degrees=True)
        rotations[:, j] = turned.as_rotvec()
    return rotations


# The synthetic source.

_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
#: Music of synthesise_song for each recording, and the delay of its music in seconds; None: no music.
Recordings = tuple[tuple[str, str | None, float], ...]
#: Names of several kinds, two of them test recordings; one music begins 80 ms late.
EXAMPLE: Recordings = (
    ("kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_madeupswing_001", "mJB2", 0.0),
    ("kthjazz_gTP_sFM_sngl_d02_015", "mJS1", 0.0),
    ("kthstreet_gLH_sFM_cAll_d01_mLH4_ch04", "mMH1", 0.08),
    ("kthstreet_gPO_sFM_cAll_d01_mPO_ch01_bombom_002", "mPO4", 0.0),
)


def write_example(folder: Path, recordings: Recordings = EXAMPLE, dance_s: float = 6, pose_s: float = 0) -> None:
    """Write synthetic recordings with a T-pose of `pose_s` seconds at either end, and their music."""
    (folder / "bvh").mkdir(parents=True, exist_ok=True)
    from dancedata.datasets._examples import write_song

    for k, (name, music, delay) in enumerate(recordings):
        write_recording(folder / "bvh" / f"{name}.bvh", k, dance_s, pose_s)
        if music is not None:
            write_song(folder / "wav" / f"{name}.wav", music, dance_s + 2 * pose_s + 0.2, late_s=delay)


def write_recording(
    path: Path, seed: int, dance_s: float = 6, pose_s: float = 0, frame_time: str = "0.008333"
) -> None:
    """Write a recording with all joints: swinging limbs, fingers at rest."""
    names, parents, offsets = list(MOTORICA21.joints), list(MOTORICA21.parents), list(MOTORICA21.offsets * 100)
    for side, sign in (("Left", 1), ("Right", -1)):
        for finger, name in enumerate(_FINGERS):
            for bone in (1, 2, 3):
                parents.append(names.index(f"{side}Hand" if bone == 1 else f"{side}Hand{name}{bone - 1}"))
                names.append(f"{side}Hand{name}{bone}")
                offsets.append(np.array([sign * (8.0 if bone == 1 else 3.0), 0.0, (3.0 - finger) * (bone == 1)]))
    n, still = round(dance_s * RATE), round(pose_s * RATE)
    t = np.arange(n) / RATE
    rng = np.random.default_rng([7, seed])
    rotations = np.zeros((n + 2 * still, len(names), 3))
    moving = slice(still, still + n)
    fade = np.minimum(1, np.minimum(t, t[-1] - t) * 4)[:, None]
    for j in range(1, MOTORICA21.n_joints):
        size, phase = rng.uniform(0.05, 0.35, 3), rng.uniform(0, 6.28, 3)
        rotations[moving, j] = fade * size * np.sin(2 * np.pi * (0.5 + 0.5 * (j % 3)) * t[:, None] + phase)
    hips = np.tile([0.0, 83.0, 0.0], (len(rotations), 1))
    hips[moving] += fade * np.stack([20 * np.sin(0.8 * t), 2 * np.cos(5 * t), 12 * np.sin(1.1 * t)], axis=1)
    matrices = matrix_from_rotvec(rotations.reshape(-1, 3)).reshape(*rotations.shape, 3)
    write_bvh(path, names, parents, np.array(offsets), matrices, hips, frame_time, "ZXY")
