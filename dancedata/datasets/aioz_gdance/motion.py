"""One AIOZ-GDANCE pickle -> the motions of its dancers in one world; and synthetic sources of that layout."""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets._rotations import require_rotations
from dancedata.datasets.motion_checks import DOWNLOAD_AGAIN, no_frames, require_dancer, require_finite, require_keys
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.values import open_arrays
from dancedata.synthetic import synthesise_motion, synthesise_song

RATE = 30
POSES, ORIENTS, TRANS = "smpl_poses", "smpl_orients", "root_trans"
JOINTS = 24
#: Columns of all joints, and of all but the root.
_ALL, _BODY = 3 * JOINTS, 3 * (JOINTS - 1)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    """Numbers of one pickle: dancers, frames, and columns of `smpl_poses`."""

    dancers: int
    frames: int
    width: int
    has_orients: bool


def read_sizes(path: Path) -> Sizes:
    """Return the sizes of a sequence.

    Raises DataError: reason ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``contradiction``
        (root rotations twice), ``length_mismatch`` or ``empty``.
    """
    with open_arrays(path) as arrays:
        return _sizes(arrays)


def load_dancers(path: Path, members: Sequence[int]) -> list[Motion]:
    """Read the motions of some dancers; the pickle is read once.

    `members`: Numbers of the dancers, from 0.
    Returns: 30 FPS; rotations (T, 24, 3) axis-angle in radians, hands zero where the file has none; translation (T,
        3) in metres as in the file, +Y up, in one world; SMPL24.
    Raises DataError: As `read_sizes`, ``nan`` and ``not_rotations`` with the dancer, or ``missing_dancer``.
    """
    with open_arrays(path) as arrays:
        sizes = _sizes(arrays)
        for member in members:
            require_dancer(path, member, sizes.dancers)
        poses, places = arrays.read(POSES)[list(members)], arrays.read(TRANS)[list(members)]
        if sizes.has_orients:
            blank = np.zeros((*poses.shape[:2], _BODY - sizes.width))
            poses = np.concatenate([arrays.read(ORIENTS)[list(members)], poses, blank], axis=-1)
    motions = []
    for member, rows, trans in zip(members, poses, places, strict=True):
        require_finite(path, f"the rotations of dancer {member}", rows, DOWNLOAD_AGAIN)
        require_finite(path, f"{TRANS} of dancer {member}", trans, DOWNLOAD_AGAIN)
        rotations = rows.reshape(len(rows), JOINTS, 3)
        require_rotations(path, f"{POSES} of dancer {member}", rotations, trans, SMPL24.parents)
        motions.append(Motion(trans, rotations, FrameGrid.of(RATE), SMPL24))
    return motions


def _sizes(arrays: ArrayFile) -> Sizes:
    """Check which of the two forms a file has, and that its arrays agree."""
    path = arrays.path
    require_keys(arrays, (POSES, TRANS), f"{POSES} and {TRANS}, and {ORIENTS} where {POSES} has no root")
    shape, has_orients = arrays.shape(POSES), ORIENTS in arrays.names
    width = shape[-1] if len(shape) == 3 else 0
    if has_orients and width == _ALL:
        raise DataError(
            f"the root's rotation is in the file twice: {POSES} has all {JOINTS} joints, and there is {ORIENTS}",
            reason="contradiction",
            where=str(path),
            found=f"{POSES} {shape}, {ORIENTS} {arrays.shape(ORIENTS)}",
            allowed=f"{POSES} (P, T, {_ALL}) alone, or (P, T, 63) with {ORIENTS} (P, T, 3)",
            fix="remove the one that is wrong",
        )
    valid = width % 3 == 0 and 0 < width <= _BODY if has_orients else width == _ALL
    if not valid:
        hint = " (the 63 columns are the body without its root)" if width == 63 else ""
        allowed = f"(P, T, n) with n at most {_BODY} and a multiple of 3" if has_orients else f"(P, T, {_ALL})"
        raise DataError(f"{POSES} has the wrong shape{' for a file without ' + ORIENTS if hint else ''}",
                        reason="bad_shape", where=str(path), found=f"{shape}{hint}", allowed=allowed,
                        fix=DOWNLOAD_AGAIN)  # fmt: skip
    for key in (TRANS, *([ORIENTS] if has_orients else [])):
        if arrays.shape(key) != (*shape[:2], 3):
            raise DataError(f"{key} and {POSES} do not agree", reason="length_mismatch", where=str(path),
                            found=f"{key} {arrays.shape(key)}, {POSES} {shape}",
                            allowed=f"{key} {(*shape[:2], 3)}: dancers, frames, 3", fix=DOWNLOAD_AGAIN)  # fmt: skip
    if not (shape[0] and shape[1]):
        raise no_frames(path)
    return Sizes(shape[0], shape[1], width, has_orients)


# The synthetic source.

_SAMPLE_RATE = 44_100
#: Sequence, dancers, official list, the synthetic clip with the steps and the song.
_SEQUENCES = (
    ("-Ab_cdEf123_01_0_180", 2, "train", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("-Ab_cdEf123_02_187_367", 3, "test", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("Zz9_8-7_6Q1_02_300_481", 5, "val", "gMH_sBM_cAll_d22_mMH1_ch04"),
    ("plainid0123_04_829_1009", 7, "train", "gHO_sBM_cAll_d19_mHO3_ch01"),
)
_BODY_ONLY, _SWAPS = 2, 1
_SPACING_M, _LARGEST_DELAY = 1.2, 6
_LABELS = {"-Ab_cdEf123": "Hip-Hop,Street", "Zz9_8-7_6Q1": "Pop,Commercial", "plainid0123": "K-Pop,Modern"}


def write_example(folder: Path) -> None:
    """Write four sequences of six seconds with 2, 3, 5 and 7 dancers, the lists and labels.

    The first video is in train and in test. The third file has the form without a root, the fourth is float64. The
    first two dancers of the second one swap places.
    """
    (folder / "motions_smpl").mkdir(parents=True, exist_ok=True)
    (folder / "musics").mkdir(exist_ok=True)
    for k, (name, dancers, _, steps) in enumerate(_SEQUENCES):
        start, end = (int(part) for part in name.rsplit("_", 2)[1:])
        n, channels = end - start, 1 + k % 2
        song = synthesise_song(steps.split("_")[4], length_s=n / RATE, sample_rate=_SAMPLE_RATE, n_channels=channels)
        (folder / "musics" / f"{name}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        content = _content(steps, dancers, n, swap=k == _SWAPS)
        content["meta"] = {"orig_start": start, "orig_end": end}
        if k == _BODY_ONLY:
            poses = content[POSES]
            content |= {POSES: poses[..., 3:66], ORIENTS: poses[..., :3]}
            del content["smpl_betas"]
        if k < len(_SEQUENCES) - 1:
            content = {key: v.astype(np.float32) if isinstance(v, np.ndarray) else v for key, v in content.items()}
        (folder / "motions_smpl" / f"{name}.pkl").write_bytes(pickle.dumps(content, protocol=4))
    for split in ("train", "val", "test"):
        names = [name for name, _, of, _ in _SEQUENCES if of == split]
        (folder / f"{split}_split_sequence_names.txt").write_text(
            "\n".join(names) + "\n", encoding="utf-8", newline="\n"
        )
        rows = ["sequence_name,music_genre,dance_style", *(f"{n},{_LABELS[n.rsplit('_', 3)[0]]}" for n in names)]
        (folder / f"{split}_labels.csv").write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")


def _content(steps: str, dancers: int, n: int, *, swap: bool) -> dict[str, Any]:
    """Return the dict of a sequence: one dance, each dancer up to 0.2 s later and in a place of his own on a line."""
    dance = synthesise_motion(steps, n_frames=2 * (n + _LARGEST_DELAY) - 1)[0].resampled(FrameGrid.of(RATE))
    delays = [(3 * member) % (_LARGEST_DELAY + 1) for member in range(dancers)]
    places = np.zeros((dancers, n, 3))
    places[..., 0] = _SPACING_M * (np.arange(dancers) - (dancers - 1) / 2)[:, None]
    if swap:  # half a circle about the middle of the two, so that they stay apart
        angle = np.pi * np.clip((np.arange(n) - n / 3) / (n / 3), 0, 1)
        middle, radius = places[:2].mean(axis=0), _SPACING_M / 2
        turn = radius * np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=-1)
        places[0], places[1] = middle - turn, middle + turn
    return {
        POSES: np.stack([dance.rotations[d : d + n].reshape(n, _ALL) for d in delays]),
        TRANS: np.stack([dance.translation[d : d + n] for d in delays]) + places,
        "smpl_betas": np.zeros((dancers, 10)),
    }
