"""A local plug-in of the benchmarks: groups of dancers, one .npz and one .wav each, world +Y up."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np

from dancedata.core.clip import ClipRef, Scan, member_id
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.segments import Layer, Segment
from dancedata.core.skeleton import SMPL24

MOVES = Layer("moves", language="en", sided="mirrored", mirror=(("left turn", "right turn"),))
WORDS = Layer("words", language="fr")


@DATASETS.register("ensemble")
@dataclass(frozen=True)
class Ensemble(Dataset):
    """Arrays `trans` (P, T, 3), `poses` (P, T, 24, 3) and `lengths` (P,) at 60 FPS, and `start`, of the song."""

    version: ClassVar[int] = 1
    licence: ClassVar[str] = "none"
    citation: ClassVar[str] = "none"

    def scan(self, source: Path) -> Scan:
        """List the dancers of all files."""
        clips = []
        for path in sorted(source.glob("*.npz")):
            with np.load(path) as file:
                size, start = len(file["lengths"]), Fraction(str(file["start"]))
            clips += [
                ClipRef(member_id(path.stem, k), path, path.with_suffix(".wav"), "train", music=path.stem,
                        group=path.stem, member=k, declared=(("place", str(k)),), audio_start=start,
                        role=("leader", "follower")[k] if size == 2 else "")
                for k in range(size)
            ]  # fmt: skip
        return Scan("ensemble", tuple(sorted(clips, key=lambda ref: ref.id)))

    def load(self, ref: ClipRef) -> Motion:
        """Load one dancer; DataError for NaN."""
        place = int(dict(ref.declared)["place"])
        with np.load(ref.motion_path) as file:
            n = int(file["lengths"][place])
            poses, trans = file["poses"][place][:n], file["trans"][place][:n]
        if np.isnan(trans).any():
            raise DataError("NaN", reason="nan", where=ref.motion_path)
        return Motion(trans, poses, FrameGrid.of(60), SMPL24, trim_start=place)

    def segments(self, ref: ClipRef) -> list[Segment]:
        """Return words of two layers, one of which names sides."""
        moves = Segment(MOVES, Fraction(1), Fraction(2), "left turn", ("turns left",), ("turns right",))
        return [moves, Segment(WORDS, Fraction(0), Fraction(5, 2), "", (f"dancer {ref.member}",))]

    def make_example(self, folder: Path) -> None:
        """Write nothing."""
