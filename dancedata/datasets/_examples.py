"""What examples of readers are made of: synthetic dances and songs in the files of published datasets."""

import json
import pickle
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.synthetic import synthesise_motion, synthesise_song


def dance(steps: str, n_frames: int, rate: int = 30) -> Motion:
    """Return a dance on SMPL's joints, `rate` divides 60; `steps` names a synthetic clip."""
    return synthesise_motion(steps, n_frames=(n_frames - 1) * 60 // rate + 1)[0].resampled(FrameGrid.of(rate))


def write_song(
    path: Path, steps: str, seconds: float, rate: int = 24_000, *, n_channels: int = 1, late_s: float = 0
) -> None:
    """Write the song of a synthetic clip, `late_s` seconds late, as wav."""
    music = steps.split("_")[4] if "_" in steps else steps
    song = synthesise_song(music, length_s=seconds, sample_rate=rate, n_channels=n_channels)
    silence = np.zeros((round(late_s * rate), n_channels), np.int16)
    write_bytes(path, wav_bytes(np.concatenate([silence, song.pcm]), rate))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def write_lines(path: Path, lines: Iterable[str], end: str = "\n") -> None:
    """Write a text of lines, the last one with an `end`."""
    write_bytes(path, ("\n".join(lines) + end).encode())


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file."""
    write_bytes(path, json.dumps(content).encode())


def write_pickle(path: Path, content: Any) -> None:
    """Write a pickle of protocol 4, as published ones are."""
    write_bytes(path, pickle.dumps(content, protocol=4))


def write_array(path: Path, array: Any) -> None:
    """Write an .npy file, also of a dict, as numpy.save does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cell = np.empty((), object)
    cell[()] = array
    np.save(path, array if isinstance(array, np.ndarray) else cell, allow_pickle=True)
