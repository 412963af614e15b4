"""One pickle of PopDanceSet -> canonical motion; and a synthetic source in its layout."""

import pickle
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24_EDGE
from dancedata.datasets._rotations import require_rotations
from dancedata.datasets.motion_checks import (
    DOWNLOAD_AGAIN,
    bad_shape,
    lengths_differ,
    no_frames,
    require_finite,
    require_keys,
    require_matrices,
)
from dancedata.formats.values import open_arrays
from dancedata.synthetic import synthesise_motion, synthesise_song

Scale = Literal["multiply", "none"]
RATE = 30
JOINTS = 24
KEYS = ("transl", "pred_thetas", "pred_camera")
#: From a camera's axes, +Y down and +Z away from it, to +Y up: half a turn about x.
_UPRIGHT = np.diag([1.0, -1.0, -1.0])
_UPRIGHT_VECTOR = np.array([np.pi, 0.0, 0.0])
#: What POPDG adds to positions after the turn, in our axes: one metre up, five towards the camera.
_POPDG_PLACE = (0.0, 1.0, 5.0)

Floats = NDArray[np.float64]


def load_motion(path: Path, scale: Scale) -> Motion:
    """Read a pickle with ``transl``, ``pred_thetas`` and ``pred_camera``; other keys are not used.

    `path`: The pickle; read with the allow-list unpickler, so nothing in it is executed.
    `scale`: "multiply": translation x pred_camera, then POPDG's shift. "none": metres in the camera's place.
    Returns: 30 FPS, +Y up; rotations (T, 24, 3) axis-angle, from 72 numbers a frame, or 216 (matrices, as HybrIK
        writes them); the pelvis is at the translation (SMPL24_EDGE).
    Raises DataError: ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``empty``,
        ``length_mismatch``, ``nan``, ``not_rotations`` or ``bad_rotation``.
    """
    with open_arrays(path) as arrays:
        needed = KEYS if scale == "multiply" else KEYS[:2]
        require_keys(arrays, needed)
        places, thetas = arrays.read("transl"), arrays.read("pred_thetas")
        camera = arrays.read("pred_camera") if scale == "multiply" else None
    n = len(places) if places.ndim == 2 and places.shape[1] == 3 else -1
    if n == -1:
        raise bad_shape(path, "transl", places.shape, "(T, 3)")
    if n == 0:
        raise no_frames(path)
    require_finite(path, "transl", places, DOWNLOAD_AGAIN)
    rotations = _rotations(path, thetas, places)
    if camera is not None:
        places = places * _factors(path, camera, n)
    shift = _POPDG_PLACE if scale == "multiply" else (0.0, 0.0, 0.0)
    rotations[:, 0] = (rotation(_UPRIGHT_VECTOR) * rotation(rotations[:, 0])).as_rotvec()
    return Motion(places @ _UPRIGHT.T + shift, rotations, FrameGrid.of(RATE), SMPL24_EDGE)


def _rotations(path: Path, thetas: Floats, places: Floats) -> Floats:
    """Return (T, 24, 3) axis-angle of the file's vectors or matrices."""
    n, size = len(thetas) if thetas.ndim else 0, thetas[0].size if thetas.ndim and len(thetas) else 0
    if size not in (3 * JOINTS, 9 * JOINTS):
        allowed = f"(T, {3 * JOINTS}) or (T, {JOINTS}, 3) of axis-angle, or (T, {9 * JOINTS}) of matrices"
        raise bad_shape(path, "pred_thetas", thetas.shape, allowed)
    if n != len(places):
        raise lengths_differ(path, "pred_thetas", n, "transl", len(places))
    require_finite(path, "pred_thetas", thetas.reshape(n, -1), DOWNLOAD_AGAIN)
    if size == 3 * JOINTS:
        vectors = thetas.reshape(n, JOINTS, 3)
        require_rotations(path, "pred_thetas", vectors, places, SMPL24_EDGE.parents)
        return vectors.copy()
    matrices = thetas.reshape(n, JOINTS, 3, 3)
    require_matrices(str(path), matrices, SMPL24_EDGE.joints)
    return rotvec_from_matrix(matrices)


def _factors(path: Path, camera: Floats, n: int) -> Floats:
    """Return the factors (T, 1) by which POPDG multiplies the translation."""
    if camera.shape not in ((n,), (n, 1)):
        if camera.ndim and len(camera) != n:
            raise lengths_differ(path, "pred_camera", len(camera), "transl", n)
        fix = "set scale: none; what scale such a file has is not known"
        raise bad_shape(path, "pred_camera", camera.shape, "(T, 1)", fix)
    require_finite(path, "pred_camera", camera, DOWNLOAD_AGAIN)
    return camera.reshape(n, 1)


# The synthetic source.

_SAMPLE_RATE = 24_000
#: Clip, frames, seconds of music beyond the motion, split; the dance and music of each come of a synthetic clip.
_CLIPS = (
    ("BVaaaaaaaa1a_Clip_1", 181, 0.0, "train", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("BVaaaaaaaa1a_Clip_2", 180, 0.2, "train", "gBR_sBM_cAll_d04_mBR0_ch02"),
    ("BVbbbbbbbb2b_Clip_1", 183, -0.2, "train", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("BVcccccccc3c_Clip_7", 180, 0.0, "test", "gMH_sBM_cAll_d22_mMH1_ch04"),
)


def write_example(folder: Path) -> None:
    """Write four clips of six seconds, one of them with matrices, and the lists."""
    for name in ("motions", "wavs", "splits"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for k, (clip, n, more_s, _, steps) in enumerate(_CLIPS):
        song = synthesise_song(
            steps.split("_")[4], length_s=n / RATE + more_s, sample_rate=_SAMPLE_RATE, n_channels=1
        )
        (folder / "wavs" / f"{clip}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        content = content_of(synthesise_motion(steps, n_frames=2 * n - 1)[0].resampled(FrameGrid.of(RATE)))
        if k == 2:
            turned = rotation(content["pred_thetas"].reshape(-1, 3)).as_matrix()
            content["pred_thetas"] = turned.reshape(n, 216).astype(np.float32)
        (folder / "motions" / f"{clip}.pkl").write_bytes(pickle.dumps(content, protocol=4))
    for split, end in (("train", "\n"), ("test", "")):
        names = [clip for clip, *_, of, _ in _CLIPS if of == split]
        (folder / "splits" / f"{split}.txt").write_text("\n".join(names) + end, encoding="utf-8", newline="\n")
    (folder / "high_quality_dataset").write_text(f"{_CLIPS[0][0]}\n", encoding="utf-8", newline="\n")


def content_of(motion: Motion) -> dict[str, Any]:
    """Return a motion as a pickle of PopDanceSet has it: the camera's axes, a slowly varying `pred_camera`."""
    n = motion.n_frames
    thetas = motion.rotations.copy()
    thetas[:, 0] = (rotation(_UPRIGHT_VECTOR) * rotation(thetas[:, 0])).as_rotvec()
    pelvis = motion.joints()[:, 0] @ _UPRIGHT.T + (0.0, 0.0, 5.0)
    camera = 0.85 + 0.3 * np.sin(np.arange(n) / 40)[:, None]
    return {
        "transl": pelvis.astype(np.float32),
        "pred_thetas": thetas.reshape(n, 72).astype(np.float32),
        "pred_camera": camera.astype(np.float32),
        "pred_betas": np.zeros((n, 10), np.float32),
    }
