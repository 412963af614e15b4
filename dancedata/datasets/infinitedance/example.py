"""A synthetic source in the layout of InfiniteDance."""

import json
import pickle
from pathlib import Path

import numpy as np

from dancedata.core.bodies import SMPLX22, on_body
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.datasets.infinitedance.motion import RATE
from dancedata.datasets.infinitedance.reader import (
    COLUMNS_FOLDER,
    FITS_FOLDER,
    MUQ_FOLDER,
    MUSIC55_FOLDER,
    TEST_FOLDER,
    TOKENS_FOLDER,
)
from dancedata.representations.humanml264 import Humanml264
from dancedata.synthetic import synthesise_motion

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
        columns = Humanml264().encode(dance)[:-1]  # the published ones have no last row
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
    (folder / "styles" / "all_style_map.json").write_text(json.dumps(styles), encoding="utf-8")
    for clip, style in styles.items():
        (folder / "styles" / f"{clip}.json").write_text(json.dumps({"style": style}), encoding="utf-8")


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
    own = {split: [clip for clip, _, is_own, of, *_ in _CLIPS if of == split and is_own] for split in of_split}
    lists = {
        "All_cleandata_train": of_split["train"], "test_eval861": of_split["test"],
        "All_train": of_split["train"], "All_eval": of_split["test"],
        "infinitedance_train": own["train"], "infinitedance_eval": own["test"],
        "aistpp_train": [clip for clip in of_split["train"] if clip not in own["train"]],
    }  # fmt: skip
    for k, (name, clips) in enumerate(lists.items()):
        (folder / f"{name}.txt").write_text("\n".join(clips) + "\n" * (k % 2), encoding="utf-8")
