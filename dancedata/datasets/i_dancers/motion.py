"""One pickle of I-Dancers -> the motions of its dancers; and a synthetic source in its layout."""

import pickle
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24
from dancedata.datasets._upright import up_axis
from dancedata.datasets.motion_checks import (
    DOWNLOAD_AGAIN,
    bad_shape,
    no_frames,
    require_dancer,
    require_finite,
    require_keys,
    require_matrices,
)
from dancedata.formats.stated import UPRIGHT
from dancedata.formats.values import open_arrays
from dancedata.synthetic import synthesise_motion, synthesise_song

KEYS = ("smpl_poses", "smpl_trans")
SUFFIX = "_smpl"
JOINTS = 24
_HEAD = SMPL24.index("head")

Floats = NDArray[np.float64]


def shape_of(path: Path) -> tuple[int, int]:
    """Return dancers and frames of a pickle; DataError if they cannot be read."""
    with open_arrays(path) as arrays:
        require_keys(arrays, KEYS)
        shape = arrays.shape("smpl_poses")
    _require_shape(path, shape)
    return shape[0], shape[1]


def load_motions(path: Path, members: Sequence[int], rate: Fraction, up: str = "auto", trim: int = 0) -> list[Motion]:
    """Read some dancers of a pickle; read with the allow-list unpickler, so nothing in it is executed.

    `members`: Numbers of the dancers, from 0.
    `rate`: Frames per second.
    `up`: Axis that is up in the file, "y" or "z"; "auto": that along which heads are above pelvises, on average over
        all dancers whose numbers are finite.
    `trim`: Frames to leave out at both ends.
    Returns: Metres, +Y up, turned about the world's origin, so dancers stay in one world; SMPL24: ``smpl_trans`` is
        SMPL's translation.
    Raises DataError: ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``missing_dancer``, ``bad_shape``,
        ``empty``, ``nan`` with the dancer, ``bad_rotation`` with frame and joint, or ``bad_axes`` if no axis is
        clearly up.
    """
    with open_arrays(path) as arrays:
        require_keys(arrays, KEYS)
        matrices, places = (arrays.read(key) for key in KEYS)
    _require_shape(path, matrices.shape)
    dancers, frames = matrices.shape[:2]
    if frames <= 2 * trim:
        raise too_short(path, frames, trim)
    if places.shape != (dancers, frames, 3):
        raise bad_shape(path, "smpl_trans", places.shape, f"{(dancers, frames, 3)}, as smpl_poses")
    for member in members:
        require_dancer(path, member, dancers)
        require_finite(path, f"dancer {member}: smpl_trans", places[member], DOWNLOAD_AGAIN)
        require_finite(path, f"dancer {member}: smpl_poses", matrices[member].reshape(frames, -1), DOWNLOAD_AGAIN)
        require_matrices(f"{path}, dancer {member}", matrices[member], SMPL24.joints)
    matrices, places = (a[:, trim : frames - trim] for a in (matrices, places))
    finite = [k for k in range(dancers) if np.isfinite(matrices[k]).all() and np.isfinite(places[k]).all()]
    grid = FrameGrid(rate)
    as_stored = {k: Motion(places[k], rotvec_from_matrix(matrices[k]), grid, SMPL24) for k in finite}
    spine = np.mean([_spine(motion) for motion in as_stored.values()], axis=0)
    upright, rest = UPRIGHT[up_axis(path, spine, up, "i-dancers")], SMPL24.offsets[0]
    turned = []
    for motion in (as_stored[member] for member in members):
        rotations = motion.rotations.copy()
        rotations[:, 0] = rotvec_from_matrix(upright @ matrix_from_rotvec(rotations[:, 0]))
        turned.append(Motion((motion.translation + rest) @ upright.T - rest, rotations, grid, SMPL24))
    return turned


def too_short(path: Path, frames: int, trim: int) -> DataError:
    """Return the error of a motion of which nothing is left."""
    return DataError("the motion has no frames left after trim_frames", reason="empty", where=str(path),
                     found=f"{frames} frames", allowed=f"more than {2 * trim}",
                     fix="set dataset.i-dancers.trim_frames to fewer frames")  # fmt: skip


def _spine(motion: Motion) -> Floats:
    """Return the vector from pelvis to head, on average."""
    joints = motion.joints()
    return np.asarray((joints[:, _HEAD] - joints[:, 0]).mean(axis=0))


def _require_shape(path: Path, shape: tuple[int, ...]) -> None:
    if len(shape) != 5 or shape[2:] != (JOINTS, 3, 3) or shape[0] < 1:
        raise bad_shape(path, "smpl_poses", shape, f"(P, T, {JOINTS}, 3, 3) of rotation matrices")
    if shape[1] == 0:
        raise no_frames(path)


# The synthetic source.

_SAMPLE_RATE, _FRAMES = 24_000, 183
#: Sequence, dancers, split.
_SEQUENCES = (("seq_001", 2, "train"), ("seq_002", 3, "train"), ("seq 010", 2, "test"))


def write_example(folder: Path) -> None:
    """Write three sequences of six seconds at 30 FPS, dancers 1.2 m apart, +Y up, and the lists."""
    for name in ("motion", "music"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for number, (name, size, _) in enumerate(_SEQUENCES):
        music = ("mBR0", "mPO1", "mHO2")[number]
        song = synthesise_song(music, length_s=_FRAMES / 30, sample_rate=_SAMPLE_RATE, n_channels=1)
        (folder / "music" / f"{name}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        dance, _ = synthesise_motion(f"gBR_sBM_cAll_d04_{music}_ch01", n_frames=2 * _FRAMES - 1)
        content = content_of(dance.resampled(FrameGrid.of(30)), size)
        (folder / "motion" / f"{name}{SUFFIX}.pkl").write_bytes(pickle.dumps(content, protocol=4))
    for split in ("train", "test"):
        names = [f"{name}{SUFFIX}.pkl" for name, _, of in _SEQUENCES if of == split]
        (folder / f"{split}.txt").write_text("\n".join(names) + "\n", encoding="utf-8", newline="\n")


def content_of(motion: Motion, size: int) -> dict[str, Any]:
    """Return copies of a dancer on a line as a pickle of I-Dancers has them."""
    matrices = np.stack([motion.matrices] * size)
    places = np.stack([np.add(motion.translation, (1.2 * k, 0.0, 0.3 * k)) for k in range(size)])
    return {"smpl_poses": matrices.astype(np.float32), "smpl_trans": places.astype(np.float32)}
