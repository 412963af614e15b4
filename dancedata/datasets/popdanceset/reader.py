"""The reader of PopDanceSet; the tree on disk is in the package's docstring."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24_EDGE, Skeleton
from dancedata.core.typing import override
from dancedata.datasets._published import Published
from dancedata.datasets.layout import Layout

# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"(BV[0-9A-Za-z]{10})_Clip_[0-9]+")


@DATASETS.register("popdanceset")
@dataclass(frozen=True)
class PopDanceSet(Published):
    """PopDanceSet, from the published files and the lists of POPDG's repository.

    Attributes
    ----------
    split
        ``official``: train.txt and test.txt of POPDG's repository; 21 of the 24 test videos are in train as well, and
        there is no val. ``by-video``: a tenth of the videos each is val and test, by a hash of their names.
    scale
        ``none``: the translation as it is, in metres. ``multiply``: translation x ``pred_camera``, which has no unit,
        one metre up and five forward, as POPDG reads the files.
    music, music_dir
        As of `Published`.
    """

    scale: Literal["multiply", "none"] = field(default="none", metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "POPDG's code and lists: MIT. Motion was estimated from videos of third parties, whose videos and music "
        "are not licensed for redistribution."
    )
    citation: ClassVar[str] = "Luo et al., POPDG: Popular 3D Dance Generation with PopDanceSet, CVPR 2024."

    layout: ClassVar[Layout] = Layout(
        dataset="popdanceset",
        title="PopDanceSet",
        motions="motions",
        suffix=".pkl",
        name_problem=lambda stem: "" if _NAME.fullmatch(stem) else "not named as a clip, BVxxxxxxxxxx_Clip_1",
        is_known=lambda name: "popdanceset" in name.lower(),
        looked_for="motions/BVxxxxxxxxxx_Clip_1.pkl and so on, in the source folder or in one folder below it",
        named="files named as BV1aaaaaaaa1_Clip_1.pkl",
        mistakes={"motions_sliced": "slices that POPDG's script made cannot be a source: use motions/ as published"},
    )
    music_folders: ClassVar[tuple[str, ...]] = ("wavs",)
    official: ClassVar[Mapping[str, str]] = {"train": "train.txt", "test": "test.txt"}
    recorded: ClassVar[Mapping[str, str]] = {"high_quality": "high_quality_dataset"}
    below: ClassVar[tuple[str, ...]] = ("splits", "data/splits", "")
    get_lists: ClassVar[str] = "copy splits/ from the folder data/ of POPDG's repository into the source"
    published: ClassVar[int] = 1036

    @staticmethod
    @override
    def video_of(name: str) -> str:
        return name.rsplit("_Clip_", 1)[0]

    @override
    def song_of(self, name: str) -> str:
        return self.video_of(name)

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24_EDGE

    @override
    def clips_of(self, ref: ClipRef) -> list[ClipRef]:
        return [replace(ref, dancer=ref.music)]  # of a video: one dancer or group of dancers

    @override
    def notes(self, clips: Sequence[ClipRef]) -> Iterable[str]:
        if self.official_split:
            yield "POPDG's repository has 1,012 train and 24 test, no val."
        none = "none: metres, with the camera 5 m or so away; POPDG multiplies by pred_camera (scale: multiply)"
        multiply = "translation x pred_camera, which has no physical unit, and POPDG's shift, as POPDG reads it"
        yield f"Scale: {none if self.scale == 'none' else multiply}."

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, radians, +Y up, SMPL24_EDGE; the scale as chosen."""
        from dancedata.datasets.popdanceset.motion import load_motion

        return load_motion(ref.motion_path, self.scale)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.popdanceset.motion import write_example

        write_example(Path(folder))
