"""One JSON file of PhantomDance -> canonical motion; and a synthetic source in its layout."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, world_matrices
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.sides import wrong_up
from dancedata.core.skeleton import SMPL24_EDGE
from dancedata.core.text import listed, quoted
from dancedata.datasets.motion_checks import DOWNLOAD_AGAIN, bad_shape, lengths_differ, no_frames, require_finite
from dancedata.files.strict_json import read_json
from dancedata.synthetic import synthesise_motion, synthesise_song

RATE = 30
#: Names of SMPL's joints in the files, in SMPL's order.
_BONES = (
    "Pelvis L_Hip R_Hip Spine1 L_Knee R_Knee Spine2 L_Ankle R_Ankle Spine3 L_Foot R_Foot Neck L_Collar R_Collar Head "
    "L_Shoulder R_Shoulder L_Elbow R_Elbow L_Wrist R_Wrist L_Hand R_Hand"
)
BONES = tuple(_BONES.split())
#: Ten minutes take about 40 MB.
MAX_BYTES = 1 << 28
#: Bound of the deviation of a quaternion's length from 1: files have a few decimals.
_TOLERANCE = 0.01
#: Unity's axes are left-handed, +X right: the mirror across x = 0 of positions, and of quaternions x y z w.
_MIRROR, _MIRROR_TURN = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])

Floats = NDArray[np.float64]


def load_motion(path: Path) -> Motion:
    """Read a dance.

    Returns: 30 FPS, metres, right-handed with +Y up; rotations (T, 24, 3) axis-angle relative to the parents,
        computed from the file's rotations in the world; the pelvis is at the translation (SMPL24_EDGE).
    Raises DataError: ``broken_file``, ``missing_key``, ``bad_skeleton``, ``bad_shape``, ``empty``,
        ``length_mismatch``, ``nan``, ``bad_rotation`` or ``bad_axes`` (the body does not stand upright).
    """
    content = _content(path)
    order = _order(path, content["bone_name"])
    places = _array(path, "root_positions", content, (3,))
    turns = _array(path, "rotations", content, (len(BONES), 4))
    if len(places) != len(turns):
        raise lengths_differ(path, "root_positions", len(places), "rotations", len(turns))
    motion = Motion(places * _MIRROR, _local(path, turns[:, order]), FrameGrid.of(RATE), SMPL24_EDGE)
    _check_axes(path, motion)
    return motion


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        raise DataError("the motion file cannot be read", reason="broken_file", where=str(path), found=str(error),
                        allowed=f"JSON of at most {MAX_BYTES:,} bytes", fix=DOWNLOAD_AGAIN) from error  # fmt: skip
    if isinstance(content, dict) and "name" in content:
        content.setdefault("bone_name", content["name"])  # of the first release
    keys = ("bone_name", "root_positions", "rotations")
    missing = [key for key in keys if not isinstance(content, dict) or key not in content]
    if missing:
        found = f"keys {listed(content, show=quoted)}" if isinstance(content, dict) else type(content).__name__
        raise DataError(
            f"the motion file has no {' and no '.join(missing)}",
            reason="missing_key",
            where=str(path),
            found=found,
            allowed=f"an object with {', '.join(keys)}",
            fix="leave files that are not motions out of the folder, or download the file again",
        )
    return dict(content)


def _order(path: Path, names: Any) -> list[int]:
    """Return the place of each of BONES in the file."""
    bones = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    if len(bones) != len(BONES) or set(bones) != set(BONES):
        raise DataError("the bones are not those of SMPL", reason="bad_skeleton", where=str(path),
                        found=listed(bones, show=quoted) or type(names).__name__,
                        allowed=f"{len(BONES)} names: {', '.join(BONES[:4])}, ...", fix=DOWNLOAD_AGAIN)  # fmt: skip
    return [bones.index(name) for name in BONES]


def _array(path: Path, key: str, content: dict[str, Any], shape: tuple[int, ...]) -> Floats:
    try:
        array = np.asarray(content[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
        found = "lists of different lengths, or something other than numbers"
    else:
        found = str(array.shape)
    if array.shape == (0,) and content[key] == []:
        raise no_frames(path)
    if array.shape[1:] != shape:
        raise bad_shape(path, key, found, f"(T, {', '.join(map(str, shape))})")
    require_finite(path, key, array, DOWNLOAD_AGAIN)
    return array


def _local(path: Path, turns: Floats) -> Floats:
    """Return axis-angle relative to the parents (T, 24, 3) of quaternions in the world (T, 24, 4), x y z w."""
    from scipy.spatial.transform import Rotation

    off = np.abs(np.linalg.norm(turns, axis=-1) - 1)
    if off.max() > _TOLERANCE:
        frame, joint = (int(k) for k in np.argwhere(off > _TOLERANCE)[0])
        raise DataError("not a quaternion of length 1", reason="bad_rotation",
                        where=f"{path}, frame {frame}, {BONES[joint]}",
                        found=f"({', '.join(f'{x:.4g}' for x in turns[frame, joint])})",
                        allowed=f"x y z w, of length 1 within {_TOLERANCE:g}", fix=DOWNLOAD_AGAIN)  # fmt: skip
    world = Rotation.from_quat((turns * _MIRROR_TURN).reshape(-1, 4)).as_matrix().reshape(*turns.shape[:2], 3, 3)
    local = world.copy()
    for joint in range(1, len(BONES)):
        local[:, joint] = np.swapaxes(world[:, SMPL24_EDGE.parents[joint]], -1, -2) @ world[:, joint]
    return rotvec_from_matrix(local)


def _check_axes(path: Path, motion: Motion) -> None:
    """Reject a file in which the body certainly does not stand upright."""
    wrong = wrong_up(motion.joints())
    if wrong is not None and wrong[1]:
        raise DataError("the body does not stand upright", reason="bad_axes", where=str(path),
                        found=f"from feet to head {np.array2string(wrong[0], precision=2)} on average",
                        allowed="Unity's axes: +X right, +Y up, +Z forward; rotations in the world",
                        fix="use the published file")  # fmt: skip


# The synthetic source.

_SAMPLE_RATE = 16_000
_CLIPS = (
    ("dance_001", "gBR_sBM_cAll_d04_mBR0_ch01", 181),
    ("dance_002", "gPO_sBM_cAll_d10_mPO4_ch03", 180),
    ("dance_003", "gMH_sBM_cAll_d22_mMH1_ch04", 186),
)


def write_example(folder: Path) -> None:
    """Write three dances of six seconds and their music."""
    for name in ("motion", "music"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, steps, n in _CLIPS:
        motion = synthesise_motion(steps, n_frames=2 * n - 1)[0].resampled(FrameGrid.of(RATE))
        (folder / "motion" / f"{name}.json").write_text(
            json.dumps(content_of(motion)), encoding="utf-8", newline="\n"
        )
        song = synthesise_song(steps.split("_")[4], length_s=n / RATE, sample_rate=_SAMPLE_RATE, n_channels=1)
        (folder / "music" / f"{name}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))


def content_of(motion: Motion) -> dict[str, Any]:
    """Return a motion on SMPL's joints as a file of PhantomDance has it."""
    from scipy.spatial.transform import Rotation

    world = world_matrices(motion.skeleton, motion.matrices)
    turns = Rotation.from_matrix(world.reshape(-1, 3, 3)).as_quat().reshape(*world.shape[:2], 4) * _MIRROR_TURN
    places = motion.joints()[:, 0] * _MIRROR
    return {
        "bone_name": list(BONES),
        "root_positions": np.round(places, 6).tolist(),
        "rotations": np.round(turns, 6).tolist(),
    }
