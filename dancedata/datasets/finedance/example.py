"""A tiny source in FineDance's layout, made of synthetic motion and music; no captured data."""

import json
import wave
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX52, SMPLX55, on_body
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation_6d
from dancedata.datasets.finedance.layout import LABELS, MOTION, MUSIC

FRAME_RATE = 30
SAMPLE_RATE = 24_000
TOE_HEIGHT_M = 0.02

# Id, frames, style1, style2, and the synthetic clip that provides steps and song. 010 has a beginning to trim
# (three frames), 063 is a test clip of both releases' cross-genre split.
CLIPS = (
    ("001", 181, "Street", "Popping", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("010", 186, "Street", "Breaking", "gBR_sFM_cAll_d04_mBR4_ch01"),
    ("063", 180, "Modern", "Hiphop", "gMH_sBM_cAll_d22_mMH1_ch04"),
    ("150", 182, "Modern", "jazz", "gJS_sFM_cAll_d01_mJS1_ch02"),
)


def write_example(folder: Path) -> None:
    """Write four clips of six seconds: ``motion/``, ``music_wav/`` and ``label_json/``."""
    for name in (MOTION, MUSIC, LABELS):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for clip, n_frames, coarse, fine, steps in CLIPS:
        np.save(folder / MOTION / f"{clip}.npy", _columns(_motion(steps, n_frames)))
        _write_song(folder / MUSIC / f"{clip}.wav", steps, n_frames)
        label = {"name": f"synthetic {clip}", "style1": coarse, "style2": fine}
        (folder / LABELS / f"{clip}.json").write_text(json.dumps(label), encoding="utf-8")


def _motion(steps: str, n_frames: int) -> Motion:
    """Return a dance on SMPL-X's joints, feet on the floor (y = 0), fingers opening and closing."""
    from dancedata.synthetic.motion import make_motion

    dance, _ = make_motion(steps, 2 * n_frames - 1, seed=0)
    motion = on_body(dance.resampled(FrameGrid.of(FRAME_RATE)), SMPLX55, keep="translation")
    rotations = motion.rotations.copy()
    curl = 0.35 - 0.25 * np.cos(2 * np.pi * np.arange(n_frames) / FRAME_RATE)
    # About z, towards the palms, which face the floor at rest.
    rotations[:, 25:40, 2] = -curl[:, None]
    rotations[:, 40:55, 2] = curl[:, None]
    feet = motion.joints()[:, list(SMPLX55.feet), 1]
    translation = motion.translation - (0.0, feet.min() - TOE_HEIGHT_M, 0.0)
    return Motion(translation, rotations, motion.grid, SMPLX55)


def _columns(motion: Motion) -> NDArray[np.float32]:
    """Return FineDance's array (T, 315): translation, then 52 joints x 6D."""
    rows = rotation_6d(on_body(motion, SMPLX52).matrices)
    columns = [motion.translation, rows.reshape(motion.n_frames, -1)]
    return np.concatenate(columns, axis=1).astype(np.float32)


def _write_song(path: Path, steps: str, n_frames: int) -> None:
    from dancedata.synthetic import synthesise_song

    music = steps.split("_")[4]
    song = synthesise_song(music, length_s=n_frames / FRAME_RATE, sample_rate=SAMPLE_RATE, n_channels=1)
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        file.writeframes(song.pcm.astype("<i2").tobytes())
