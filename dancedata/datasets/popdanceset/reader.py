"""The reader of PopDanceSet; the tree on disk is in the package's docstring."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24_EDGE, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import Files, clips_note, list_audio, read_names, relative, require_choices
from dancedata.datasets.layout import Folders, Layout

if TYPE_CHECKING:
    from collections.abc import Sequence

OFFICIAL, BY_VIDEO = "official", "by-video"
HIGH_QUALITY = "high_quality_dataset"
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
#: Clips of the published set, and of its lists.
CLIPS, TRAIN, TEST = 1036, 1012, 24
# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"(BV[0-9A-Za-z]{10})_Clip_[0-9]+")
_GET_LISTS = "copy splits/ from the folder data/ of POPDG's repository into the source, or set split: by-video"


def _name_problem(stem: str) -> str:
    return "" if _NAME.fullmatch(stem) else "not named as a clip, BVxxxxxxxxxx_Clip_1"


def video_of(clip: str) -> str:
    """Return the video of a clip, its BV number: one song, one dancer or group of dancers."""
    return clip.rsplit("_Clip_", 1)[0]


LAYOUT = Layout(
    dataset="popdanceset",
    title="PopDanceSet",
    motions="motions",
    suffix=".pkl",
    name_problem=_name_problem,
    is_known=lambda name: "popdanceset" in name.lower(),
    looked_for="motions/BVxxxxxxxxxx_Clip_1.pkl and so on, in the source folder or in one folder below it",
    named="files named as BV1aaaaaaaa1_Clip_1.pkl",
    mistakes={"motions_sliced": "slices that POPDG's script made cannot be a source: use motions/ as published"},
)


@dataclass(frozen=True)
class _Lists:
    """The lists of POPDG's repository; `where` is the folder with train and test."""

    split: Mapping[str, tuple[str, ...]]
    high_quality: frozenset[str]
    where: str

    @classmethod
    def find(cls, folders: Folders) -> "_Lists":
        places = [place for root in folders.places for place in (root / "splits", root / "data" / "splits", root)]
        folder = next((p for p in places if all((p / f"{name}.txt").is_file() for name in ("train", "test"))), None)
        best = next((p / HIGH_QUALITY for p in (*folders.places, *places) if (p / HIGH_QUALITY).is_file()), None)
        high_quality = frozenset() if best is None else frozenset(read_names(best))
        if folder is None:
            return cls({}, high_quality, "")
        lists = {name: tuple(dict.fromkeys(read_names(folder / f"{name}.txt"))) for name in ("train", "test")}
        return cls(lists, high_quality, relative(folder, folders.source))

    def of(self, clip: str) -> tuple[str, ...]:
        """Return the names of the lists that hold a clip."""
        names = [name for name, clips in self.split.items() if clip in clips]
        return (*names, *(["high_quality"] if clip in self.high_quality else []))


@DATASETS.register("popdanceset")
@dataclass(frozen=True)
class PopDanceSet(Dataset):
    """PopDanceSet, from the published files and the lists of POPDG's repository.

    Attributes
    ----------
    split
        ``official``: train.txt and test.txt of POPDG's repository; 21 of the 24 test videos are in train as well, and
        there is no val. ``by-video``: a tenth of the videos each is val and test, by a hash of their names.
    scale
        ``none``: the translation as it is, in metres. ``multiply``: translation x ``pred_camera``, which has no unit,
        one metre up and five forward, as POPDG reads the files.
    music
        ``required`` leaves out clips without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})
    scale: Literal["multiply", "none"] = field(default="none", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "POPDG's code and lists: MIT. Motion was estimated from videos of third parties, whose videos and music "
        "are not licensed for redistribution."
    )
    citation: ClassVar[str] = "Luo et al., POPDG: Popular 3D Dance Generation with PopDanceSet, CVPR 2024."

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return self.split == "official"

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24_EDGE

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads lists of names, but neither motion nor music.

        Returns
        -------
        Scan
            Clips by name with split and lists (train, test, high_quality); music and dancer are the video. Rejects,
            each by name: ``unassigned``, ``missing_music``, ``missing_motion`` (listed, but no pickle),
            ``unused_music``, ``extra_file``. Notes state the lists, what they share, and the scale in use.
        """
        folders, motions = LAYOUT.list_motions(Path(source))
        music = self._music(folders)
        lists = _Lists.find(folders)
        if self.split == OFFICIAL:
            self._require_lists(folders, lists)
        clips, left_out = self._clips(folders, motions, music, lists)
        listed_names = {name for names in lists.split.values() for name in names}
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no motions/{name}.pkl")
            for name in sorted(listed_names - set(motions.files))
        ]
        unused = music.without_motion(motions.files, folders.source, "motions/{}.pkl")
        at = relative(folders.root / LAYOUT.motions, folders.source)
        notes = (
            f"Layout: PopDanceSet, by {at}/*.pkl ({counted(len(motions.files), 'file')}; {CLIPS:,} were published); "
            f"{counted(len(music.files), 'audio file')}.",
            *music.notes,
            *self._split_notes(lists),
            self._scale_note(),
            clips_note(clips, left_out),
        )
        return Scan(
            "popdanceset", tuple(clips), (*left_out, *missing, *unused, *music.rejects, *motions.rejects), notes
        )

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, radians, +Y up, SMPL24_EDGE; the scale as chosen."""
        from dancedata.datasets.popdanceset.motion import load_motion

        return load_motion(ref.motion_path, self.scale)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.popdanceset.motion import write_example

        write_example(Path(folder))

    def _music(self, folders: Folders) -> Files:
        return list_audio([folders.root / "wavs"], folders.source, _name_problem, music_dir=self.music_dir)

    def _require_lists(self, folders: Folders, lists: _Lists) -> None:
        if not lists.split:
            raise SourceError("popdanceset: the official lists are missing", where=str(folders.root),
                              found="no folder with train.txt and test.txt",
                              allowed="splits/train.txt and splits/test.txt", fix=_GET_LISTS)  # fmt: skip
        both = sorted(set(lists.split["train"]) & set(lists.split["test"]))
        if both:
            raise SourceError("popdanceset: train.txt and test.txt name the same clips",
                              where=str(folders.source / lists.where), found=listed(both),
                              fix=_GET_LISTS)  # fmt: skip

    def _clips(
        self, folders: Folders, motions: Files, music: Files, lists: _Lists
    ) -> "tuple[list[ClipRef], list[Reject]]":
        """Turn every pickle into a clip or a reject."""
        clips, rejects = [], []
        for clip, path in sorted(motions.files.items()):
            file, audio, video = relative(path, folders.source), music.files.get(clip), video_of(clip)
            of = lists.of(clip)
            split = RULE.split(video) if self.split == BY_VIDEO else next((s for s in of if s in lists.split), "")
            if not split:
                detail = f"in neither list of {lists.where}; split: by-video assigns every clip"
                rejects.append(Reject("unassigned", clip=clip, file=file, detail=detail))
            elif audio is None and self.music == "required":
                detail = f"no wavs/{clip} as wav, flac, mp3 or ogg"
                rejects.append(Reject("missing_music", clip=clip, file=file, detail=detail, music=video))
            else:
                clips.append(
                    ClipRef(
                        id=clip,
                        motion_path=path,
                        audio_path=audio,
                        split=split,
                        music=video,
                        dancer=video,
                        lists=of,
                        keys=(("video", video),),
                    )
                )
        return clips, rejects

    def _split_notes(self, lists: _Lists) -> "Sequence[str]":
        """Return the split in use, and the videos that the official lists share."""
        if not lists.split:
            return [
                "Splits: by-video: a tenth of the videos each is val and test, by a hash of their names; no lists."
            ]
        train, test = (lists.split[name] for name in ("train", "test"))
        shared = sorted({video_of(clip) for clip in test} & {video_of(clip) for clip in train})
        of_test = sum(video_of(clip) in shared for clip in test)
        leak = f"{of_test:,} of {len(test):,} test clips are of videos of train ({listed(shared, 3)})"
        if self.split == BY_VIDEO:
            text = "Splits: by-video: a tenth of the videos each is val and test, by a hash of their names."
            return [text, *([f"Leak of the official lists, which are not used: {leak}."] if shared else [])]
        text = (
            f"Splits: official, from {lists.where}/: {len(train):,} train, {len(test):,} test ({TRAIN:,} and {TEST} "
            f"in POPDG's repository), no val; {len(lists.high_quality):,} on {HIGH_QUALITY}."
        )
        return [text, *([f"Leak: {leak}; split: by-video keeps videos together."] if shared else [])]

    def _scale_note(self) -> str:
        if self.scale == "multiply":
            return (
                "Scale: translation x pred_camera, which has no physical unit, and POPDG's shift, as POPDG reads it."
            )
        return (
            "Scale: none: metres, with the camera 5 m or so away; POPDG multiplies by pred_camera (scale: multiply)."
        )
