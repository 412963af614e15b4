"""What a report of a model's samples holds: scores, numbers of each sample, and the nearest poses of train."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from dancedata.pages.document import Document
from dancedata.pages.measure import ClipNumbers
from dancedata.pages.outliers import Outlier

SCHEMA = 1
#: What `dancedata.evaluate` returns; satellites do not know each other's classes.
Scores: TypeAlias = Any
#: Split of the samples among the poses.
SAMPLES = "samples"


def of_sample(clip: str) -> str:
    """Return the name of a sample among the clips of the dataset, which may have the same."""
    return f"{SAMPLES}/{clip}"


def sample_of(name: str) -> str:
    """Return the sample of a name of `of_sample`."""
    return name.removeprefix(f"{SAMPLES}/")


@dataclass(frozen=True)
class NearestPose:
    """The pose of a sample that is farthest from all poses of train, and the pose of train nearest to it."""

    clip: str
    # `seconds`, `train_seconds`: times of both in their clips
    seconds: float
    train_clip: str
    train_seconds: float
    distance_m: float  # rms distance over joints
    # `pose`, `train_pose`: (22, 3) joints relative to the root, turned to the front, metres
    pose: tuple[tuple[float, ...], ...]
    train_pose: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class SampleRow:
    """A sample: its song, its numbers, and the median distance of its poses to the nearest of train, metres."""

    clip: str
    sample: str  # its name among the scores; a dancer of a group has that of the group
    song: str
    numbers: ClipNumbers
    to_train_m: float | None


@dataclass(frozen=True)
class SamplesReport:
    """Samples of a model beside the dataset that it was trained on."""

    name: str
    scores: Scores  # the samples under a protocol, with the real dances beside them
    rows: tuple[SampleRow, ...]
    outliers: tuple[Outlier, ...]  # samples with a number far above the median of the dataset's clips
    nearest: tuple[NearestPose, ...]  # of each sample the pose farthest from train, the farthest first
    dataset: Document  # the numbers of the dataset; its map of poses has the samples, too
    clips: Mapping[str, ClipNumbers]  # numbers of the clips of the dataset
    path: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        rows = [
            {"clip": r.clip, "song": r.song, "to_train_m": r.to_train_m, **asdict(replace(r.numbers, path=()))}
            for r in self.rows
        ]
        poses = self.dataset.poses
        return {
            "schema": SCHEMA, "path": None if self.path is None else str(self.path), "samples": self.name,
            "against": self.dataset.about.name, "scores": self.scores.to_json(), "clips": rows,
            "outliers": [asdict(outlier) for outlier in self.outliers],
            "to_train_m": {name: asdict(near) for name, near in poses.to_train.items()},
            "to_train_chance_m": None if poses.chance is None else asdict(poses.chance),
            "frechet": {kind: {s: asdict(v) for s, v in of.items()} for kind, of in poses.frechet.items()},
            "copies_of_train": [asdict(pair) for pair in poses.duplicates if SAMPLES in pair.splits],
            "nearest": [
                {k: v for k, v in asdict(near).items() if k not in ("pose", "train_pose")} for near in self.nearest
            ],
        }  # fmt: skip
