"""The reader of AIOZ-GDANCE; the tree on disk is in the package's docstring."""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from dancedata.core.clip import ClipRef, Scan, member_id
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed, quoted
from dancedata.core.typing import override
from dancedata.datasets._published import Published
from dancedata.datasets.files import MAX_LIST_BYTES, SPLITS
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.regular_file import read_regular

# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"([0-9A-Za-z_-]+)_([0-9]+)_([0-9]+)_([0-9]+)")


def frames_of(name: str) -> int:
    """Return the number of frames that a sequence's name states."""
    start, end = name.rsplit("_", 2)[1:]
    return int(end) - int(start)


@DATASETS.register("aioz-gdance")
@dataclass(frozen=True)
class AiozGdance(Published):
    """AIOZ-GDANCE, from the published files: each clip is one dancer, each sequence a group.

    Attributes
    ----------
    split
        ``official``: the three lists, which share videos. ``by-video``: a tenth of the videos each is val and test,
        by a hash of their ids; sequences on no list are included.
    music, music_dir
        As of `Published`.
    genre_column
        Title of the column of the label files with the genre of the music; by default the only one with "genre".
    style_column
        The same of the style of the dance, by default the only one with "style".
    """

    genre_column: str = field(default="", metadata={"scan": True})
    style_column: str = field(default="", metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "AIOZ-GDANCE's own licence: one user, non-commercial research only; no distribution, in whole or in part."
    )
    citation: ClassVar[str] = "Le et al., Music-Driven Group Choreography, CVPR 2023."

    layout: ClassVar[Layout] = Layout(
        dataset="aioz-gdance",
        title="AIOZ-GDANCE",
        motions="motions_smpl",
        suffix=".pkl",
        name_problem=lambda stem: "" if _NAME.fullmatch(stem) else "not named VIDEO_SEGMENT_START_END",
        is_known=lambda name: "gdance" in name.lower(),
        looked_for="motions_smpl/VIDEO_SEGMENT_START_END.pkl, in the source folder or in one folder below it",
        named="files named as -abcDEF_123_01_187_1358.pkl",
        mistakes={
            "motions_sliced": "slices that TCDiff's script made cannot be a source: use motions_smpl/ as published"
        },
    )
    music_folders: ClassVar[tuple[str, ...]] = ("musics", "music", "musics438")
    official: ClassVar[Mapping[str, str]] = {split: f"{split}_split_sequence_names.txt" for split in SPLITS}
    recorded: ClassVar[Mapping[str, str]] = {f"dancers_{n}": f"split_dancerNum_{n}.txt" for n in range(2, 8)}
    published: ClassVar[int] = 1624

    @staticmethod
    @override
    def video_of(name: str) -> str:
        return name.rsplit("_", 3)[0]  # a YouTube id may contain "_" and begin with "-"

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24

    @override
    def scan(self, source: Path) -> Scan:
        """List the dancers, ``<sequence>_p<member>``, as `Published`; UsageError for a missing column of labels."""
        scan, labels = super().scan(source), self._labels(self.layout.find(Path(source)))
        return replace(scan, clips=tuple(replace(clip, **labels.get(clip.group, {})) for clip in scan.clips))

    @override
    def clips_of(self, ref: ClipRef) -> list[ClipRef]:
        from dancedata.datasets.aioz_gdance.motion import read_sizes

        sizes, stated = read_sizes(ref.motion_path), frames_of(ref.id)
        notes = () if sizes.frames == stated else (f"{sizes.frames:,} frames, but {stated:,} by its name",)
        return [
            replace(ref, id=member_id(ref.id, member), group=ref.id, member=member, notes=notes)
            for member in range(sizes.dancers)
        ]

    @override
    def notes(self, clips: Sequence[ClipRef]) -> Iterable[str]:
        yield "Axes: +Y up, metres, 30 FPS, as published; the dancers of a sequence share one world."
        if self.official_split:
            yield "GCD and TCDiff train on train; TCDiff reports on val."
        first = {clip.group: clip for clip in clips}
        sizes = Counter(Counter(clip.group for clip in clips).values())
        by_size = ", ".join(f"{n:,} of {size}" for size, n in sorted(sizes.items()))
        if first:
            yield f"Groups: {counted(len(first), 'sequence')} ({by_size} dancers); their order is the tracker's."
        other = [f"{name} ({clip.notes[0]})" for name, clip in sorted(first.items()) if clip.notes]
        if other:
            yield f"Lengths: {counted(len(other), 'sequence')}: {listed(other, 3)}. GCD repeats the last frame."

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

    def _labels(self, folders: Folders) -> dict[str, dict[str, Any]]:
        """Return genre and style by sequence, from the tables beside the lists."""
        labels: dict[str, dict[str, Any]] = {}
        files = [place / f"{split}_labels.csv" for place in folders.places for split in SPLITS]
        for path in dict.fromkeys(file for file in files if file.is_file()):
            header, *rows = _table(path)
            genre = _column(path, header, "genre_column", self.genre_column, "genre")
            style = _column(path, header, "style_column", self.style_column, "style")
            for row in rows:
                values = [row[k].strip() if k is not None and k < len(row) else "" for k in (genre, style)]
                columns = (("style", values[1]),) if values[1] else ()
                labels[row[0].strip()] = {"genre": values[0], "columns": columns}
        return labels


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
