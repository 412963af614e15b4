"""One DD100 file -> the motion of one dancer in the pair's world, +Y up; and synthetic sources of that layout."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.bodies import SMPLX55, on_body
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_rotvec, rotvec_from_matrix
from dancedata.datasets._rotations import require_rotations
from dancedata.datasets.motion_checks import (
    DOWNLOAD_AGAIN,
    bad_shape,
    lengths_differ,
    no_frames,
    require_finite,
    require_keys,
)
from dancedata.formats.stated import UPRIGHT
from dancedata.formats.values import ValueArrays, load_object
from dancedata.synthetic import synthesise_motion, synthesise_song

RATE = 30
KEYS = ("poses", "global_orient", "transl")
JOINTS = SMPLX55.n_joints
#: Largest difference between entries of the root's two rotation matrices.
_SAME_ROOT = 1e-3
_HEAD, _PELVIS = SMPLX55.index("head"), 0

Floats = NDArray[np.float64]


def load_dancer(path: Path, up: str = "z") -> Motion:
    """Read one dancer.

    `path`: An .npy file that holds a dict; nothing in it is executed.
    `up`: Axis that is up in the file, "z" or "y".
    Returns: 30 FPS; rotations (T, 55, 3) axis-angle in radians; translation (T, 3) in metres; turned to +Y up about
        the world's origin, so partners stay in one world; SMPLX55: betas are not used.
    Raises DataError: reason ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``length_mismatch``,
        ``empty``, ``nan``, ``not_rotations``, ``contradiction`` (the root's two rotations), or ``bad_axes`` if heads
        are not above pelvises.
    """
    content = load_object(path)
    arrays = ValueArrays(path, content)
    require_keys(arrays, KEYS)
    poses, root, places = (arrays.read(key) for key in KEYS)
    if poses.shape[1:] not in ((3 * JOINTS,), (JOINTS, 3)):
        hint = " (SMPL-H has 156)" if poses.shape[1:] == (156,) else ""
        raise bad_shape(path, "poses", f"{poses.shape}{hint}", f"(T, {3 * JOINTS}) or (T, {JOINTS}, 3), SMPL-X")
    for key, array in (("global_orient", root), ("transl", places)):
        if array.ndim != 2 or array.shape[1] != 3:
            raise bad_shape(path, key, array.shape, "(T, 3)")
        if len(array) != len(poses):
            raise lengths_differ(path, "poses", len(poses), key, len(array))
    if len(poses) == 0:
        raise no_frames(path)
    for key, array in zip(KEYS, (poses, root, places), strict=True):
        require_finite(path, key, array, DOWNLOAD_AGAIN)
    rotations = poses.reshape(len(poses), JOINTS, 3).copy()
    require_rotations(path, "poses", rotations, places, SMPLX55.parents)
    turned = matrix_from_rotvec(rotations[:, 0])
    off = np.abs(turned - matrix_from_rotvec(root)).max(axis=(1, 2))
    if off.max() > _SAME_ROOT:
        frame = int((off > _SAME_ROOT).argmax())
        raise DataError(
            "the root's rotation is in the file twice, and they differ",
            reason="contradiction",
            where=f"{path}, frame {frame}",
            found=f"poses {rotations[frame, 0].round(4).tolist()}, global_orient {root[frame].round(4).tolist()}",
            fix=DOWNLOAD_AGAIN,
        )
    upright, pelvis = UPRIGHT[up], SMPLX55.offsets[0]
    rotations[:, 0] = rotvec_from_matrix(upright @ turned)
    motion = Motion((places + pelvis) @ upright.T - pelvis, rotations, FrameGrid.of(RATE), SMPLX55)
    joints = motion.joints()
    spine = (joints[:, _HEAD] - joints[:, _PELVIS]).mean(axis=0) @ upright
    axis = int(np.abs(spine).argmax())
    if spine[axis] <= 0 or axis != "xyz".index(up):
        raise DataError(
            f"heads are not above pelvises along +{up}",
            reason="bad_axes",
            where=str(path),
            found=f"from pelvis to head on average {spine.round(2).tolist()} m",
            fix="set dataset.dd100.up to the axis that is up (z as published, or y), or download the file again",
        )
    return motion


# The synthetic source.

_SAMPLE_RATE = 24_000
#: Pair, frames, the synthetic clip with the steps and the song.
_PAIRS = (
    ("Ballet_9_0", 246, "gLH_sBM_cAll_d16_mLH1_ch01"),
    ("Waltz_5_0", 249, "gJS_sFM_cAll_d01_mJS1_ch02"),
    ("Waltz_6_0", 253, "gHO_sBM_cAll_d19_mHO3_ch01"),
)
_SHORTER, _APART_M = 3, 0.9


def write_example(folder: Path) -> None:
    """Write three pairs of eight seconds: two of test, one of train; leaders are float32, 3 frames shorter."""
    motions, songs = folder / "motion" / "smplx" / "all", folder / "music" / "mp3" / "all"
    for place in (motions, songs):
        place.mkdir(parents=True, exist_ok=True)
    for name, n, steps in _PAIRS:
        song = synthesise_song(steps.split("_")[4], length_s=n / RATE, sample_rate=_SAMPLE_RATE, n_channels=1)
        (songs / f"{name}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        dance = on_body(synthesise_motion(steps, n_frames=2 * n - 1)[0].resampled(FrameGrid.of(RATE)), SMPLX55)
        for member, length, kind in ((0, n, np.float64), (1, n - _SHORTER, np.float32)):
            content = content_of(dance.part(0, length), facing=member == 1)
            arrays = {key: array.astype(kind) for key, array in content.items()}
            cell = np.empty((), object)
            cell[()] = {**arrays, "meta": {"gender": ("female", "male")[member]}}
            np.save(motions / f"{name}_0{member}.npy", cell, allow_pickle=True)


def content_of(motion: Motion, *, facing: bool) -> dict[str, Any]:
    """Return a dancer on SMPL-X as a file of DD100 has it, +Z up; `facing`: turned round, opposite the partner."""
    turn = np.diag([-1.0, 1.0, -1.0]) if facing else np.eye(3)
    world, pelvis = UPRIGHT["z"].T @ turn, SMPLX55.offsets[0]
    rotations = motion.rotations.copy()
    rotations[:, 0] = rotvec_from_matrix(world @ motion.matrices[:, 0])
    rotations[:, 25:40, 2] -= 0.3
    rotations[:, 40:55, 2] += 0.3
    place = motion.translation + pelvis + (0.0, 0.0, -_APART_M / 2)
    return {
        "poses": rotations.reshape(len(rotations), -1),
        "global_orient": rotations[:, 0],
        "transl": place @ world.T - pelvis,
        "betas": np.full((len(rotations), 10), 0.1),
    }
