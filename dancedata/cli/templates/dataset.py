"""template_name: a folder with one motion file and one music file for each clip.

::

    SOURCE/NAME.npz    poses (T, 24, 3) axis-angle in radians, trans (T, 3) in metres, +Y up, fps ()
    SOURCE/NAME.wav    its music, from the same instant on
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24


@DATASETS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Dataset):
    """One .npz and one .wav for each clip, all in one folder and in the split train."""

    version: ClassVar[int] = 1  # raise it whenever load gives other numbers: it is part of the cache key
    licence: ClassVar[str] = "not stated"  # of the data, for the dataset card
    citation: ClassVar[str] = "not stated"

    def scan(self, source: Path) -> Scan:
        """List the clips and, by name, what is left out; reads no motion and no music."""
        paths = sorted(source.glob("*.npz")) if source.is_dir() else []
        if not paths:
            found = "no .npz file" if source.is_dir() else "not a folder"
            raise SourceError("template_name: there are no clips", where=source, found=found, allowed="NAME.npz")
        clips = [ClipRef(p.stem, p, p.with_suffix(".wav"), "train", music=p.stem) for p in paths]
        with_music = tuple(c for c in clips if c.audio_path is not None and c.audio_path.is_file())
        rejects = tuple(
            Reject("missing_music", c.id, str(c.motion_path), detail=f"there is no {c.id}.wav", music=c.music)
            for c in clips
            if c not in with_music
        )
        return Scan("template_name", with_music, rejects, (f"{len(with_music)} clips with music.",))

    def load(self, ref: ClipRef) -> Motion:
        """Read one clip; Motion itself refuses wrong shapes, NaN and motions without frames."""
        try:
            with np.load(ref.motion_path, allow_pickle=False) as file:
                poses, trans, fps = file["poses"], file["trans"], float(file["fps"])
        except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
            raise DataError(
                "the file cannot be read", reason="broken_file", where=ref.motion_path, found=str(error)
            ) from error
        except KeyError as error:
            raise DataError(
                "a key is missing", reason="missing_key", where=ref.motion_path, found=str(error)
            ) from error
        try:
            grid = FrameGrid.of(fps)
        except (UsageError, TypeError) as error:
            raise DataError(
                "fps is not a frame rate", reason="bad_rate", where=ref.motion_path, found=str(error)
            ) from error
        return Motion(trans, poses, grid, SMPL24)

    def make_example(self, folder: Path) -> None:
        """Write two clips of six seconds; the conformance suite builds from them."""
        import soundfile

        folder.mkdir(parents=True, exist_ok=True)
        frames, samples = np.arange(360) / 60, np.arange(6 * 22050) / 22050
        for name, bpm in (("slow", 100), ("fast", 120)):
            swing = np.sin(np.pi * bpm / 60 * frames)
            poses = np.zeros((360, 24, 3))
            poses[:, 1:10, 0] = 0.3 * swing[:, None]
            trans = np.stack([0 * frames, 0.9 + 0.02 * swing, 0 * frames], axis=1)
            clicks = np.sin(2 * np.pi * 440 * samples) * np.exp(-30 * (samples % (60 / bpm)))
            np.savez(folder / f"{name}.npz", poses=poses, trans=trans, fps=60)
            soundfile.write(folder / f"{name}.wav", 0.5 * clicks, 22050)
