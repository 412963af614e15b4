"""One file of InfiniteDance -> canonical motion: a fit of SMPL-X, or 264 columns; and a synthetic source."""

import json
import pickle
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX22, on_body
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import matrix_from_rotvec, rotvec_from_matrix
from dancedata.datasets._rotations import require_rotations
from dancedata.datasets._upright import up_axis
from dancedata.datasets.infinitedance.corpus import (
    COLUMNS_FOLDER,
    FITS_FOLDER,
    MUQ_FOLDER,
    MUSIC55_FOLDER,
    TEST_FOLDER,
    TOKENS_FOLDER,
)
from dancedata.datasets.motion_checks import (
    DOWNLOAD_AGAIN,
    bad_shape,
    lengths_differ,
    no_frames,
    require_finite,
    require_keys,
)
from dancedata.formats.stated import UPRIGHT
from dancedata.formats.values import open_arrays
from dancedata.synthetic import synthesise_motion

RATE = 30
KEYS = ("body_pose", "global_orient", "transl")
#: Joints of `body_pose`: SMPL-X's body without the root; SMPL's 23 end with the hands.
BODY, SMPL_BODY = 21, 23
AXES = ("y", "z", "-y")
COLUMNS = 264
_HEAD = SMPLX22.index("head")
_OTHER_COLUMNS = {263: "; 263 are HumanML3D's", 266: "; 266 have the root's x and z as well"}

Floats = NDArray[np.float64]


def load_fit(path: Path, up: str = "auto") -> Motion:
    """Read a fit of SMPL-X's body.

    `path`: A file of joblib, or a pickle; read with the allow-list unpickler, so nothing in it is executed.
    `up`: Axis that is up in the file, "y", "z" or "-y" (a camera's axes); "auto": that along which the head is above
        the pelvis, on average over the frames.
    Returns: 30 FPS, metres, +Y up; rotations (T, 22, 3) of SMPLX22; ``transl`` is SMPL-X's translation. Of a
        ``body_pose`` of 69 numbers the last two joints, SMPL's hands, are not used.
    Raises DataError: ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``length_mismatch``,
        ``empty``, ``nan``, ``not_rotations``, or ``bad_axes`` if no axis is clearly up.
    """
    with open_arrays(path) as arrays:
        require_keys(arrays, KEYS)
        pose, root, places = (arrays.read(key) for key in KEYS)
    if pose.ndim < 2 or pose[:1].size not in (0, 3 * BODY, 3 * SMPL_BODY):
        raise bad_shape(path, "body_pose", pose.shape, "(T, 63) or (T, 21, 3); of SMPL (T, 69) or (T, 23, 3)")
    n = len(pose)
    for key, array in (("global_orient", root), ("transl", places)):
        if not array.ndim or array[:1].size not in (0, 3):
            raise bad_shape(path, key, array.shape, "(T, 3)")
        if len(array) != n:
            raise lengths_differ(path, "body_pose", n, key, len(array))
    if not n:
        raise no_frames(path)
    for key, array in zip(KEYS, (pose, root, places), strict=True):
        require_finite(path, key, array, DOWNLOAD_AGAIN)
    places = places.reshape(n, 3)
    rotations = np.concatenate([root.reshape(n, 1, 3), pose.reshape(n, -1, 3)[:, :BODY]], axis=1)
    require_rotations(path, "body_pose", rotations, places, SMPLX22.parents)
    grid, rest = FrameGrid.of(RATE), SMPLX22.offsets[0]
    joints = Motion(places, rotations, grid, SMPLX22).joints()
    upright = UPRIGHT[up_axis(path, (joints[:, _HEAD] - joints[:, 0]).mean(axis=0), up, "infinitedance", AXES)]
    rotations[:, 0] = rotvec_from_matrix(upright @ matrix_from_rotvec(rotations[:, 0]))
    return Motion((places + rest) @ upright.T - rest, rotations, grid, SMPLX22)


def load_columns(path: Path) -> Motion:
    """Read a file of 264 columns as the joints that they hold, with rotations fitted to them.

    Returns: As humanml264 decodes them, 30 FPS: a clip begins at the origin, facing +Z.
    Raises DataError: ``broken_file``, ``bad_shape``, ``empty``, or ``nan`` with frame and column.
    """
    with open_arrays(path) as arrays:
        shape = arrays.shape("") if arrays.names == ("",) else ()
        columns = arrays.read("") if len(shape) == 2 and shape[1] == COLUMNS else None
    if columns is None:
        hint = _OTHER_COLUMNS.get(shape[1], "") if len(shape) == 2 else ""
        raise bad_shape(path, "the array", shape, f"(T, {COLUMNS}){hint}")
    if not len(columns):
        raise no_frames(path)
    require_finite(path, "the array", columns, DOWNLOAD_AGAIN, columns=True)
    return REPRESENTATIONS.get("humanml264")().decode(columns, FrameGrid.of(RATE))


# The synthetic source.

#: Clip, frames, whether it is a fit of the dataset's own, split, style, and the synthetic clip with the steps.
_CLIPS = (
    ("video_0001", 182, True, "train", "Popular", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("my clip 2 (live)", 185, True, "train", "Folk", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("gBR_sBM_cAll_d04_mBR0_ch02", 183, False, "train", "", "gBR_sBM_cAll_d04_mBR0_ch02"),
    ("video_0002", 184, True, "test", "Modern", "gMH_sBM_cAll_d22_mMH1_ch04"),
)
#: Numbers of the first code of each level, and codes of a level; frames of a triplet; rows of MuQ per second.
FIRST_CODES, CODES, FRAMES_PER_TOKEN, MUQ_RATE = (4096, 4608, 5120), 512, 4, 25


def write_example(folder: Path) -> None:
    """Write four clips of six seconds: fits, columns, tokens, features with random values, lists and styles."""
    folders = (FITS_FOLDER, COLUMNS_FOLDER, TEST_FOLDER, TOKENS_FOLDER, MUQ_FOLDER, MUSIC55_FOLDER)
    for name in (*folders, "partition", "styles"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for clip, n, is_own, split, _, steps in _CLIPS:
        dance = on_body(synthesise_motion(steps, n_frames=2 * n - 1)[0].resampled(FrameGrid.of(RATE)), SMPLX22)
        if is_own:
            _write_fit(folder / FITS_FOLDER / f"{clip}.pkl", dance, flat=clip.startswith("video"))
        columns = REPRESENTATIONS.get("humanml264")().encode(dance)[:-1]  # the published ones have no last row
        for name in (COLUMNS_FOLDER, TEST_FOLDER) if split == "test" else (COLUMNS_FOLDER,):
            np.save(folder / name / f"{clip}.npy", columns)
        triplets = rng.integers(0, CODES, (len(columns) // FRAMES_PER_TOKEN, len(FIRST_CODES))) + FIRST_CODES
        np.save(folder / TOKENS_FOLDER / f"{clip}.npy", triplets.reshape(-1))
        features = rng.normal(size=(n, 55)).astype(np.float32)
        features[:, 53] = np.arange(n) % 15 == 0
        np.save(folder / MUSIC55_FOLDER / f"{clip}.npy", features)
        if split == "test":
            muq = rng.normal(size=(n * MUQ_RATE // RATE, 1024)).astype(np.float32)
            np.save(folder / MUQ_FOLDER / f"{clip}.npy", muq)
    _write_lists(folder / "partition")
    styles = {clip: style for clip, _, _, _, style, _ in _CLIPS if style}
    (folder / "styles" / "all_style_map.json").write_text(json.dumps(styles), encoding="utf-8", newline="\n")
    for clip, style in styles.items():
        (folder / "styles" / f"{clip}.json").write_text(json.dumps({"style": style}), encoding="utf-8", newline="\n")


def _write_fit(path: Path, dance: Motion, flat: bool) -> None:
    pose = dance.rotations[:, 1:].astype(np.float32)
    content = {
        "body_pose": pose.reshape(len(pose), -1) if flat else pose,
        "global_orient": dance.rotations[:, 0].astype(np.float32),
        "transl": dance.translation.astype(np.float32),
    }
    path.write_bytes(pickle.dumps(content, protocol=4))  # joblib.load reads these as well


def _write_lists(folder: Path) -> None:
    of_split = {split: [clip for clip, _, _, of, *_ in _CLIPS if of == split] for split in ("train", "test")}
    of_infinitedance = {
        split: [clip for clip, _, is_own, of, *_ in _CLIPS if of == split and is_own] for split in of_split
    }
    lists = {
        "All_cleandata_train": of_split["train"], "test_eval861": of_split["test"],
        "All_train": of_split["train"], "All_eval": of_split["test"],
        "infinitedance_train": of_infinitedance["train"], "infinitedance_eval": of_infinitedance["test"],
        "aistpp_train": [clip for clip in of_split["train"] if clip not in of_infinitedance["train"]],
    }  # fmt: skip
    for k, (name, clips) in enumerate(lists.items()):
        (folder / f"{name}.txt").write_text("\n".join(clips) + "\n" * (k % 2), encoding="utf-8", newline="\n")
