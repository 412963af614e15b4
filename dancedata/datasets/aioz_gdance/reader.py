"""The reader of AIOZ-GDANCE; the tree on disk is in the package's docstring."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

from dancedata.core.clip import ClipRef, Reject, Scan, member_id
from dancedata.core.errors import DataError, SourceError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import (
    SPLITS,
    Files,
    Folders,
    Layout,
    clips_note,
    list_audio,
    read_names,
    relative,
    require_choice,
)

OFFICIAL, BY_VIDEO = "official", "by-video"
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
#: Sequences and videos of the published set.
SEQUENCES, VIDEOS = 1624, 311
# Explicit ranges: \d would accept digits of other scripts. Videos may contain "_": the name is split from the right.
_NAME = re.compile(r"([0-9A-Za-z_-]{11})_([0-9]+)_([0-9]+)_([0-9]+)")
_GET_LISTS = "download the lists with the data, or set split: by-video"
#: Largest file of labels, bytes.
_MAX_LABELS = 1 << 24


class SequenceName(NamedTuple):
    """VIDEO_SEGMENT_START_END; start and end are frames of the video, and end - start the frames of the sequence."""

    video: str
    segment: str
    start: int
    end: int


def parse_name(stem: str) -> SequenceName | None:
    """Take a name apart; None for any other name."""
    match = _NAME.fullmatch(stem)
    if match is None or int(match[4]) <= int(match[3]):
        return None
    return SequenceName(match[1], match[2], int(match[3]), int(match[4]))


def _name_problem(stem: str) -> str:
    return "" if parse_name(stem) else "not named VIDEO_SEGMENT_START_END, with a video id of 11 characters"


LAYOUT = Layout(
    dataset="aioz-gdance",
    title="AIOZ-GDANCE",
    motions="motions_smpl",
    suffix=".pkl",
    name_problem=_name_problem,
    is_known=lambda name: "gdance" in name.lower(),
    looked_for="motions_smpl/VIDEO_SEGMENT_START_END.pkl, in the source folder or in one folder below it",
    named="files named as abcdefghijk_01_0_180.pkl",
    mistakes={"motion_single_pkl": "InfiniteDance's pickles of single dancers are no groups: use motions_smpl/"},
)


@DATASETS.register("aioz-gdance")
@dataclass(frozen=True)
class AiozGdance(Dataset):
    """AIOZ-GDANCE, from the published files; each dancer is a clip, each sequence a group.

    Attributes
    ----------
    split
        ``official``: the published lists, whose train and test share videos. ``by-video``: a tenth of the videos each
        is val and test, by a hash of their names.
    music
        ``required`` leaves out sequences without music; ``optional`` keeps them, for recipes without audio features.
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "AIOZ-GDANCE: one user, non-commercial research, no distribution. Motion was estimated from videos of third "
        "parties, whose music is not licensed for redistribution."
    )
    citation: ClassVar[str] = "Le et al., Music-Driven Group Choreography, CVPR 2023."

    def __post_init__(self) -> None:
        require_choice("aioz-gdance", "split", self.split, (OFFICIAL, BY_VIDEO))
        require_choice("aioz-gdance", "music", self.music, ("required", "optional"))

    @property
    @override
    def official_split(self) -> bool:
        return self.split == OFFICIAL

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24

    @override
    def scan(self, source: Path) -> Scan:
        """List the dancers; opens every pickle to count them, as names do not say how many there are.

        Returns
        -------
        Scan
            Clips NAME_p0, NAME_p1, ... with group, split, lists, music (the sequence) and the key ``video``. Rejects,
            each by name: those of a pickle that cannot be read, ``wrong_length`` (not END - START frames),
            ``unassigned``, ``missing_music``, ``missing_motion`` (listed, but no pickle), ``unused_music``,
            ``extra_file``. Notes state the lists and what they share.

        Raises
        ------
        SourceError
            If the folder is not a copy of AIOZ-GDANCE, or lists are missing or name a sequence twice.
        """
        folders, motions = LAYOUT.list_motions(Path(source))
        places = [folders.root / "musics", folders.root / "music"]
        music = list_audio([place for place in places if place.is_dir()], folders.source, _name_problem)
        lists = _find_lists(folders)
        if self.split == OFFICIAL:
            self._require_lists(folders, lists)
        clips, left_out = self._clips(folders, motions, music, lists)
        listed_names = {name for names in lists.values() for name in names}
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no motions_smpl/{name}.pkl")
            for name in sorted(listed_names - set(motions.files))
        ]
        unused = [
            Reject("unused_music", file=relative(path, folders.source), detail=f"there is no motions_smpl/{name}.pkl")
            for name, path in music.files.items()
            if name not in motions.files
        ]
        notes = (
            f"Layout: AIOZ-GDANCE, by {relative(folders.root / LAYOUT.motions, folders.source)}/*.pkl "
            f"({counted(len(motions.files), 'sequence')}; {SEQUENCES:,} were published); "
            f"{counted(len(music.files), 'audio file')}.",
            *music.notes,
            *self._split_notes(lists),
            "The order of a sequence's dancers is the tracker's: it means nothing between sequences.",
            clips_note(clips, left_out),
        )
        return Scan(
            "aioz-gdance", tuple(clips), (*left_out, *missing, *unused, *music.rejects, *motions.rejects), notes
        )

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: 30 FPS, metres, radians, +Y up, SMPL24; DataError as of `motion.load_motions`."""
        return self.load_group([ref])[0]

    @override
    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        """Read the dancers of one sequence, whose pickle is read once."""
        from dancedata.datasets.aioz_gdance.motion import load_motions

        path = refs[0].motion_path
        motions, name = load_motions(path), parse_name(path.stem)
        if name is not None and motions[0].n_frames != name.end - name.start:
            raise DataError(
                "the name states another number of frames",
                reason="wrong_length",
                where=str(path),
                found=f"{motions[0].n_frames} frames",
                allowed=f"{name.end - name.start}, from {name.start} to {name.end}",
                fix="download the file again, or rename it by its frames",
            )
        if max(ref.member for ref in refs) >= len(motions):
            raise DataError(
                "the file has fewer dancers than when it was listed", reason="changed", where=str(path),
                found=len(motions), fix="build again",
            )  # fmt: skip
        return [motions[ref.member] for ref in refs]

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.aioz_gdance.motion import write_example

        write_example(Path(folder))

    def _require_lists(self, folders: Folders, lists: Mapping[str, tuple[str, ...]]) -> None:
        missing = [f"{split}_split_sequence_names.txt" for split in ("train", "test") if split not in lists]
        if missing:
            raise SourceError(
                "aioz-gdance: official lists are missing",
                where=str(folders.root),
                found=f"no {listed(missing)}",
                allowed="train_split_sequence_names.txt, val_..., test_...",
                fix=_GET_LISTS,
            )
        names = [name for of_split in lists.values() for name in of_split]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise SourceError(
                "aioz-gdance: a sequence is in two lists",
                where=str(folders.root),
                found=listed(twice),
                fix=_GET_LISTS,
            )

    def _clips(
        self, folders: Folders, motions: Files, music: Files, lists: Mapping[str, tuple[str, ...]]
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every dancer of every pickle into a clip, or the pickle into a reject."""
        from dancedata.datasets.aioz_gdance.motion import count_dancers

        near = NearMusic(
            folders.source, list(folders.places), set(music.files.values()), lambda stem: parse_name(stem) is not None
        )
        split_of = {name: split for split, names in lists.items() for name in names}
        labels = _read_labels(folders)
        clips, rejects = [], []
        for sequence, path in sorted(motions.files.items()):
            name, file, audio = parse_name(sequence), relative(path, folders.source), music.files.get(sequence)
            if name is None:
                continue  # `list_motions` rejected it
            split = RULE.split(name.video) if self.split == BY_VIDEO else split_of.get(sequence, "")
            fix = "" if audio else near.fix(relative(folders.root / "musics" / sequence, folders.source))
            if not split:
                detail = "in none of the official lists; split: by-video assigns every sequence"
                rejects.append(Reject("unassigned", clip=sequence, file=file, detail=detail))
                continue
            if audio is None and self.music == "required":
                detail = f"no musics/{sequence} as wav, flac, mp3 or ogg"
                rejects.append(
                    Reject("missing_music", clip=sequence, file=file, detail=detail, music=sequence, fix=fix)
                )
                continue
            try:
                n = count_dancers(path)
            except DataError as error:
                rejects.append(Reject(error.reason, clip=sequence, file=file, detail=str(error)))
                continue
            genre, style = labels.get(sequence, ("", ""))
            clips += [
                ClipRef(
                    id=member_id(sequence, member), motion_path=path, audio_path=audio, split=split, music=sequence,
                    genre=genre, lists=(split_of[sequence],) if sequence in split_of else (), music_fix=fix,
                    group=sequence, member=member, keys=(("video", name.video),),
                    columns=(("dance_style", style),) if style else (),
                )
                for member in range(n)
            ]  # fmt: skip
        return sorted(clips, key=lambda ref: ref.id), rejects

    def _split_notes(self, lists: Mapping[str, tuple[str, ...]]) -> Sequence[str]:
        """Return the split in use, and the videos that the official lists share."""
        videos = {split: {parse_name(n).video for n in names if parse_name(n)} for split, names in lists.items()}  # type: ignore[union-attr]
        shared = sorted(videos.get("test", set()) & videos.get("train", set()))
        rule = "Splits: by-video: a tenth of the videos each is val and test, by a hash of their names."
        counts = ", ".join(f"{len(names):,} {split}" for split, names in lists.items())
        text = f"Splits: official: {counts} sequences." if self.split == OFFICIAL else rule
        if not shared:
            return [text]
        used = "" if self.split == OFFICIAL else " of the official lists, which are not used"
        leak = f"Leak{used}: train and test share {counted(len(shared), 'video')} ({listed(shared, 3)})"
        return [text, leak + ("; split: by-video keeps videos together." if self.split == OFFICIAL else ".")]


def _find_lists(folders: Folders) -> dict[str, tuple[str, ...]]:
    """Return the names of the official lists that there are; of a line with several columns the first is the name."""
    lists = {}
    for split in SPLITS:
        file = next(
            (p for root in folders.places if (p := root / f"{split}_split_sequence_names.txt").is_file()), None
        )
        if file is not None:
            names = [line.split(",")[0].strip() for line in read_names(file)]
            lists[split] = tuple(dict.fromkeys(names))
    return lists


def _read_labels(folders: Folders) -> dict[str, tuple[str, str]]:
    """Return music genre and dance style by sequence, from the columns whose titles say so; nothing without them."""
    labels: dict[str, tuple[str, str]] = {}
    for split in SPLITS:
        file = next((p for root in folders.places if (p := root / f"{split}_labels.csv").is_file()), None)
        if file is None or file.stat().st_size > _MAX_LABELS:
            continue
        rows = list(csv.reader(file.read_text(encoding="utf-8-sig", errors="replace").splitlines()))
        titles = [title.lower() for title in rows[0]] if rows else []
        music = next((k for k, title in enumerate(titles) if "music" in title), None)
        style = next((k for k, title in enumerate(titles) if "dance" in title or "style" in title), None)
        for row in rows[1:]:
            if row:
                values = (row[k].strip() if k is not None and k < len(row) else "" for k in (music, style))
                labels[row[0].strip()] = (next(values), next(values))
    return labels
