"""The reader of AIOZ-GDANCE; the tree on disk is in the package's docstring."""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan, member_id
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed, quoted
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import (
    MAX_LIST_BYTES,
    SPLITS,
    Files,
    clips_note,
    list_audio,
    read_names,
    relative,
    require_choices,
)
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.regular_file import read_regular

OFFICIAL, BY_VIDEO = "official", "by-video"
MUSIC = ("musics", "music", "musics438")
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
#: Sequences of the published lists.
SEQUENCES = 1624
# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"([0-9A-Za-z_-]+)_([0-9]+)_([0-9]+)_([0-9]+)")
_SIZES = range(2, 8)


def _name_problem(stem: str) -> str:
    return "" if _NAME.fullmatch(stem) else "not named VIDEO_SEGMENT_START_END"


def video_of(name: str) -> str:
    """Return the YouTube id of a sequence, which may contain ``_`` and begin with ``-``."""
    return name.rsplit("_", 3)[0]


def frames_of(name: str) -> int:
    """Return the number of frames that a sequence's name states."""
    start, end = name.rsplit("_", 2)[1:]
    return int(end) - int(start)


LAYOUT = Layout(
    dataset="aioz-gdance",
    title="AIOZ-GDANCE",
    motions="motions_smpl",
    suffix=".pkl",
    name_problem=_name_problem,
    is_known=lambda name: "gdance" in name.lower(),
    looked_for="motions_smpl/VIDEO_SEGMENT_START_END.pkl, in the source folder or in one folder below it",
    named="files named as -abcDEF_123_01_187_1358.pkl",
    mistakes={
        "motions_sliced": "slices that TCDiff's script made cannot be a source: use motions_smpl/ as published"
    },
)


@dataclass(frozen=True)
class _Lists:
    """The lists of a source: the three official ones, and others that are only recorded."""

    official: Mapping[str, tuple[str, ...]]
    others: Mapping[str, frozenset[str]]

    @classmethod
    def find(cls, folders: Folders) -> "_Lists":
        names = {split: f"{split}_split_sequence_names.txt" for split in SPLITS}
        names |= {f"dancers_{n}": f"split_dancerNum_{n}.txt" for n in _SIZES}
        lists = {}
        for name, file in names.items():
            path = next((place / file for place in folders.places if (place / file).is_file()), None)
            if path is not None:
                # Read as a table without a header by GCD: further columns may follow.
                lists[name] = tuple(dict.fromkeys(word.split(",")[0] for word in read_names(path)))
        official = {name: lists.pop(name) for name in SPLITS if name in lists}
        return cls(official, {name: frozenset(content) for name, content in lists.items()})

    def of(self, name: str) -> tuple[str, ...]:
        """Return the names of the lists that hold a sequence, the split first."""
        splits = [split for split, names in self.official.items() if name in names]
        return (*splits, *(other for other, names in self.others.items() if name in names))


@DATASETS.register("aioz-gdance")
@dataclass(frozen=True)
class AiozGdance(Dataset):
    """AIOZ-GDANCE, from the published files: each clip is one dancer, each sequence a group.

    Attributes
    ----------
    split
        ``official``: the three lists, which share videos. ``by-video``: a tenth of the videos each is val and test,
        by a hash of their ids; sequences on no list are included.
    music
        ``required`` leaves out sequences without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    genre_column
        Title of the column of the label files with the genre of the music; by default the only one with "genre".
    style_column
        The same of the style of the dance, by default the only one with "style".
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})
    genre_column: str = field(default="", metadata={"scan": True})
    style_column: str = field(default="", metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "AIOZ-GDANCE's own licence: one user, non-commercial research only; no distribution, in whole or in part."
    )
    citation: ClassVar[str] = "Le et al., Music-Driven Group Choreography, CVPR 2023."

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return self.split == OFFICIAL

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24

    @override
    def scan(self, source: Path) -> Scan:
        """List the dancers; reads lists, labels, and the sizes in each pickle, but neither motion nor music.

        Returns
        -------
        Scan
            Clips ``<sequence>_p<member>``: group and music are the sequence, `keys` has the video. Rejects, each by
            the sequence's name: ``unassigned``, ``missing_music``, ``missing_motion`` (listed, but no pickle), the
            reasons of a pickle that cannot be used, ``unused_music``, ``extra_file``. Notes state the lists, the
            videos that they share, and sequences with another length than their name says.

        UsageError if a column of the labels is not there.
        """
        folders, motions = LAYOUT.list_motions(Path(source))
        places = [place / name for place in folders.places for name in MUSIC]
        music = list_audio(places, folders.source, _name_problem, music_dir=self.music_dir)
        lists, labels = _Lists.find(folders), self._labels(folders)
        if self.split == OFFICIAL:
            _require_lists(folders, lists)
        clips, left_out = self._clips(folders, motions, music, lists, labels)
        names = sorted({name for official in lists.official.values() for name in official} - set(motions.files))
        missing = [
            Reject(
                "missing_motion", clip=name, detail=f"on the list {lists.of(name)[0]}, but no motions_smpl/{name}.pkl"
            )
            for name in names
        ]
        unused = music.without_motion(motions.files, folders.source, "motions_smpl/{}.pkl")
        at = relative(folders.root / LAYOUT.motions, folders.source)
        notes = (
            f"Layout: AIOZ-GDANCE, by {at}/*.pkl ({counted(len(motions.files), 'sequence')}; {SEQUENCES:,} were "
            f"published); {counted(len(music.files), 'audio file')}.",
            "Axes: +Y up, metres, 30 FPS, as published; the dancers of a sequence share one world.",
            *music.notes,
            *self._split_notes(lists),
            *_group_notes(clips),
            clips_note(clips, left_out),
        )
        rejects = (*left_out, *missing, *unused, *music.rejects, *motions.rejects)
        return Scan("aioz-gdance", tuple(sorted(clips, key=lambda clip: clip.id)), rejects, notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: 30 FPS, metres, radians, +Y up, SMPL24, in the world of the sequence."""
        return self.load_group([ref])[0]

    @override
    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        from dancedata.datasets.aioz_gdance.motion import load_dancers

        return load_dancers(refs[0].motion_path, [ref.member for ref in refs])

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.aioz_gdance.motion import write_example

        write_example(Path(folder))

    def _clips(
        self, folders: Folders, motions: Files, music: Files, lists: _Lists, labels: Mapping[str, tuple[str, str]]
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every pickle into the clips of its dancers, or into a reject."""
        from dancedata.datasets.aioz_gdance.motion import read_sizes

        clips, rejects = [], []
        for name, path in sorted(motions.files.items()):
            file, audio, of = relative(path, folders.source), music.files.get(name), lists.of(name)
            split = RULE.split(video_of(name)) if self.split == BY_VIDEO else next((s for s in SPLITS if s in of), "")
            if not split:
                detail = "on none of the official lists; split: by-video assigns every sequence"
                rejects.append(Reject("unassigned", clip=name, file=file, detail=detail))
                continue
            if audio is None and self.music == "required":
                detail = f"no {MUSIC[0]}/{name} as wav, flac, mp3 or ogg"
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=name))
                continue
            try:
                sizes = read_sizes(path)
            except DataError as error:
                rejects.append(Reject(error.reason, clip=name, file=file, detail=str(error)))
                continue
            genre, style = labels.get(name, ("", ""))
            note = f"{sizes.frames:,} frames, but {frames_of(name):,} by its name"
            clips += [
                ClipRef(
                    id=member_id(name, member),
                    motion_path=path,
                    audio_path=audio,
                    split=split,
                    music=name,
                    genre=genre,
                    lists=of,
                    notes=() if sizes.frames == frames_of(name) else (note,),
                    group=name,
                    member=member,
                    keys=(("video", video_of(name)),),
                    columns=(("style", style),) if style else (),
                )
                for member in range(sizes.dancers)
            ]
        return clips, rejects

    def _labels(self, folders: Folders) -> dict[str, tuple[str, str]]:
        """Return genre and style by sequence, from the tables beside the lists."""
        labels = {}
        files = [place / f"{split}_labels.csv" for place in folders.places for split in SPLITS]
        for path in dict.fromkeys(file for file in files if file.is_file()):
            rows = _table(path)
            genre, style = (
                _column(path, rows[0], *choice)
                for choice in (
                    ("genre_column", self.genre_column, "genre"),
                    ("style_column", self.style_column, "style"),
                )
            )
            for row in rows[1:]:
                values = [row[k].strip() if k is not None and k < len(row) else "" for k in (genre, style)]
                labels[row[0].strip()] = (values[0], values[1])
        return labels

    def _split_notes(self, lists: _Lists) -> list[str]:
        """Return the split in use, and the videos that the official lists share."""
        videos = {split: {video_of(name) for name in names} for split, names in lists.official.items()}
        leaks = []
        for split, earlier in (("val", "train"), ("test", "train"), ("test", "val")):
            names = lists.official.get(split, ())
            shared = videos.get(earlier, set()) & videos.get(split, set())
            if shared:
                n, which = sum(video_of(name) in shared for name in names), listed(sorted(shared), 3)
                leaks.append(f"{n:,} of {len(names):,} {split} sequences are of videos of {earlier} ({which})")
        leak = "; ".join(leaks)
        if self.split == BY_VIDEO:
            text = "Splits: by-video: a tenth of the videos each is val and test, by a hash of their ids."
            return [text, *([f"Leak of the official lists, which are not used: {leak}."] if leak else [])]
        sizes = ", ".join(f"{len(names):,} {split}" for split, names in lists.official.items())
        return [
            f"Splits: official: {sizes}. GCD and TCDiff train on train; TCDiff reports on val.",
            *([f"Leak: {leak}; split: by-video keeps videos together."] if leak else []),
        ]


def _require_lists(folders: Folders, lists: _Lists) -> None:
    missing = [f"{split}_split_sequence_names.txt" for split in SPLITS if split not in lists.official]
    if missing:
        raise SourceError("aioz-gdance: official lists are missing", where=str(folders.root),
                          found=f"no {listed(missing)}",
                          fix="copy the lists of the dataset into the source, or set split: by-video")  # fmt: skip
    counts = Counter(name for names in lists.official.values() for name in names)
    both = sorted(name for name, n in counts.items() if n > 1)
    if both:
        raise SourceError(
            "aioz-gdance: the official lists name the same sequences",
            where=str(folders.root),
            found=listed(
                [f"{name} ({' and '.join(s for s in SPLITS if name in lists.official[s])})" for name in both], 5
            ),
            fix="download the lists again, or set split: by-video",
        )


def _table(path: Path) -> list[list[str]]:
    """Return the rows of a label file that are not empty; SourceError if it is not a table."""
    try:
        text = read_regular(path, MAX_LIST_BYTES).decode("utf-8-sig")
        rows = [row for row in csv.reader(text.splitlines()) if row]
        if rows:
            return rows
        problem = "no header"
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        problem = str(error)
    raise SourceError("aioz-gdance: the labels cannot be read", where=str(path), found=problem,
                      allowed="a table with a header; the sequence in its first column",
                      fix="download the file again, or remove it")  # fmt: skip


def _column(path: Path, header: Sequence[str], key: str, title: str, part: str) -> int | None:
    """Return the column with a title, or the only one whose title contains a word; None if no title does."""
    titles = [name.strip() for name in header]
    columns = [k for k, name in enumerate(titles) if k and (name == title if title else part in name.lower())]
    if len(columns) == 1 or not (columns or title):
        return columns[0] if columns else None
    raise UsageError(f"aioz-gdance: {'no column' if title else 'several columns'} of the labels may be the {part}",
                     where=str(path), found=listed(titles, 20, quoted),
                     fix=f"set dataset.aioz-gdance.{key} to one of the titles")  # fmt: skip


def _group_notes(clips: Iterable[ClipRef]) -> list[str]:
    """Return the numbers of groups by size, and of sequences with a length that their name does not have."""
    first = {clip.group: clip for clip in clips}
    sizes = Counter(Counter(clip.group for clip in clips).values())
    by_size = ", ".join(f"{n:,} of {size}" for size, n in sorted(sizes.items()))
    notes = (
        [f"Groups: {counted(len(first), 'sequence')} ({by_size} dancers); their order is the tracker's."]
        if first
        else []
    )
    other = [f"{name} ({clip.notes[0]})" for name, clip in sorted(first.items()) if clip.notes]
    if other:
        notes.append(f"Lengths: {counted(len(other), 'sequence')}: {listed(other, 3)}. GCD repeats the last frame.")
    return notes
