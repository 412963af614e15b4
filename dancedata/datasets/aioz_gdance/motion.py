"""One pickle of AIOZ-GDANCE -> the motions of its dancers; and a synthetic source in its layout."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, quoted
from dancedata.datasets._rotations import require_rotations
from dancedata.datasets.files import require_finite
from dancedata.formats.arrays import ArrayFile, open_arrays
from dancedata.synthetic import synthesise_motion, synthesise_song
from dancedata.synthetic.music import wav_bytes

RATE = 30
JOINTS = 24
_DOWNLOAD_AGAIN = "download the file again"

Floats = NDArray[np.float64]


def count_dancers(path: Path) -> int:
    """Return how many dancers a pickle holds; DataError if that cannot be read."""
    with open_arrays(path) as arrays:
        _require_keys(path, arrays)
        shape = arrays.shape("smpl_poses")
    if len(shape) != 3 or shape[0] < 1:
        raise _bad_shape(path, "smpl_poses", shape, "(P, T, 72), or (P, T, 63) with smpl_orients")
    return int(shape[0])


def load_motions(path: Path) -> list[Motion]:
    """Read the dancers of a pickle, in its order; read with the allow-list unpickler, so nothing in it is executed.

    Returns
    -------
    list of Motion
        30 FPS, metres, +Y up, SMPL24: ``root_trans`` is SMPL's translation. ``smpl_poses`` of 63 numbers are the 21
        body joints without root and hands: ``smpl_orients`` goes before them and hands are at rest, as in GCD.

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``empty``, ``length_mismatch``,
        ``contradiction`` (72 numbers and smpl_orients), ``nan`` with the dancer, or ``not_rotations``.
    """
    with open_arrays(path) as arrays:
        _require_keys(path, arrays)
        poses, places = arrays.read("smpl_poses"), arrays.read("root_trans")
        orients = arrays.read("smpl_orients") if "smpl_orients" in arrays.names else None
    if poses.ndim != 3 or poses.shape[0] < 1:
        raise _bad_shape(path, "smpl_poses", poses.shape, "(P, T, 72), or (P, T, 63) with smpl_orients")
    n, frames, width = poses.shape
    if frames == 0:
        raise DataError("the motion has no frames", reason="empty", where=str(path), fix=_DOWNLOAD_AGAIN)
    if places.shape != (n, frames, 3):
        raise _bad_shape(path, "root_trans", places.shape, f"{(n, frames, 3)}, as smpl_poses")
    if orients is not None:
        poses = _joined(path, poses, orients)
    elif width != 3 * JOINTS:
        raise _bad_shape(path, "smpl_poses", poses.shape, "(P, T, 72); fewer numbers need smpl_orients (P, T, 3)")
    motions = []
    for dancer in range(n):
        where = f"dancer {dancer}: "
        require_finite(path, f"{where}root_trans", places[dancer], _DOWNLOAD_AGAIN)
        require_finite(path, f"{where}smpl_poses", poses[dancer], _DOWNLOAD_AGAIN)
        rotations = poses[dancer].reshape(frames, JOINTS, 3)
        require_rotations(path, f"{where}smpl_poses", rotations, places[dancer], SMPL24.parents)
        motions.append(Motion(places[dancer], rotations, FrameGrid.of(RATE), SMPL24))
    return motions


def _joined(path: Path, poses: Floats, orients: Floats) -> Floats:
    """Put the root's rotations before those of the other joints, and joints that are missing at rest."""
    n, frames, width = poses.shape
    if width > 3 * (JOINTS - 1) or width % 3:
        raise DataError(
            "smpl_orients and smpl_poses contradict each other",
            reason="contradiction",
            where=str(path),
            found=f"smpl_poses {poses.shape} beside smpl_orients {orients.shape}",
            allowed="72 numbers without smpl_orients, or at most 69 with it",
            fix=_DOWNLOAD_AGAIN,
        )
    if orients.shape != (n, frames, 3):
        raise _bad_shape(path, "smpl_orients", orients.shape, f"{(n, frames, 3)}, as smpl_poses")
    rest = np.zeros((n, frames, 3 * JOINTS - 3 - width))
    return np.concatenate([orients, poses, rest], axis=2)


def _require_keys(path: Path, arrays: ArrayFile) -> None:
    missing = [key for key in ("smpl_poses", "root_trans") if key not in arrays.names]
    if missing:
        raise DataError(
            f"the motion file has no {' and no '.join(missing)}",
            reason="missing_key",
            where=str(path),
            found=f"keys {listed(arrays.names, show=quoted) or 'none'}",
            allowed="a dict with smpl_poses and root_trans",
            fix=_DOWNLOAD_AGAIN,
        )


def _bad_shape(path: Path, key: str, shape: tuple[int, ...], allowed: str) -> DataError:
    return DataError(
        f"{key} has the wrong shape", reason="bad_shape", where=str(path), found=str(shape), allowed=allowed,
        fix=_DOWNLOAD_AGAIN,
    )  # fmt: skip


# The synthetic source.

_SAMPLE_RATE = 44_100
#: Sequence, dancers, split: three videos, one of them in train and test.
_SEQUENCES = (
    ("-Ab_cdEf123_01_0_180", 2, "train"),
    ("-Ab_cdEf123_02_187_370", 3, "test"),
    ("Zz9_8-7_6Q1_01_0_181", 5, "train"),
    ("plainid0123_01_829_1009", 2, "val"),
)
#: Listed, but without a pickle.
_LOST = "plainid0123_09_0_200"


def write_example(folder: Path) -> None:
    """Write four sequences of six seconds: lines of dancers, 1.2 m apart; pickles of both forms, lists, labels."""
    for name in ("motions_smpl", "musics"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, size, split in _SEQUENCES:
        start, end = (int(number) for number in name.split("_")[-2:])
        frames = end - start
        song = synthesise_song("mBR0", length_s=frames / RATE, sample_rate=_SAMPLE_RATE, n_channels=2)
        (folder / "musics" / f"{name}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        dancers = [
            synthesise_motion(f"gBR_sBM_cAll_d0{4 + k}_mBR0_ch0{1 + k}", n_frames=2 * frames - 1)[0].resampled(
                FrameGrid.of(RATE)
            )
            for k in range(size)
        ]
        content = content_of(dancers, start, end, separate_root=size == 5)
        (folder / "motions_smpl" / f"{name}.pkl").write_bytes(pickle.dumps(content, protocol=3))
        label = f"{name},Hip-Hop,Street\n"
        labels = folder / f"{split}_labels.csv"
        before = labels.read_text() if labels.is_file() else "sequence_name,music_genre,dance_style\n"
        labels.write_text(before + label)
    for split in ("train", "val", "test"):
        names = [name for name, _, of in _SEQUENCES if of == split] + [_LOST] * (split == "test")
        (folder / f"{split}_split_sequence_names.txt").write_text("\n".join(names) + "\n")


def content_of(dancers: list[Motion], start: int, end: int, *, separate_root: bool = False) -> dict[str, Any]:
    """Return dancers, moved 1.2 m apart, as a pickle of AIOZ-GDANCE has them."""
    poses = np.stack([dancer.rotations.reshape(dancer.n_frames, 72) for dancer in dancers]).astype(np.float32)
    apart = np.array([[[1.2 * k, 0.0, 0.4 * (k % 2)]] for k in range(len(dancers))])
    places = np.stack([dancer.translation for dancer in dancers]) + apart
    content: dict[str, Any] = {"root_trans": places.astype(np.float32), "smpl_poses": poses}
    if separate_root:
        content |= {"smpl_orients": poses[..., :3], "smpl_poses": poses[..., 3:66]}
    return {
        **content,
        "smpl_betas": np.zeros((len(dancers), 10), np.float32),
        "meta": {"orig_start": start, "orig_end": end},
    }
