"""dancedata check --offsets: the offset between the music and the motion of a source."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.alignment.rhythm import OffsetGroup, Search, find_offsets, found_start, recordings
from dancedata.core.arguments import Overrides, folder_of
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.left_out import left_out_lines
from dancedata.core.rejects import missing_music, relative_to
from dancedata.core.tables import csv_cell, table
from dancedata.core.text import counted, listed
from dancedata.files.cache_files import running
from dancedata.files.csv_report import csv_text, require_new_csv, write_csv
from dancedata.kernel import DATASET_FILE, Cache, Progress, RecipeLike, chosen_recipe, jobs_of, scan_folder
from dancedata.metrics.offsets import REASONS, Offset

BY = ("recording", "clip", "song")
#: Least offsets that are summarised, and above which p (Rayleigh's) their phases of the beat are scattered.
_FEW, _SCATTERED = 5, 0.05
_CSV = ("id", "unit", "music", "offset_s", "width_s", "p", "rivals", "beat_s", "unknown", "audio_start_s")


@dataclass(frozen=True)
class Aligned:
    """Clips with one offset: of a recording, a clip or a song."""

    name: str
    clips: tuple[ClipRef, ...]
    offset: Offset

    def start_of(self, clip: ClipRef) -> Fraction | None:
        """Return the second of the music at frame 0 of a clip's motion file; None if it is unknown."""
        if self.offset.unknown:
            return None
        return found_start(clip.audio_start - (clip.source_start or 0), self.offset)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        offset = self.offset
        numbers = {
            name: None if value is None else round(value, 4)
            for name, value in (
                ("offset_s", offset.offset_s), ("width_s", offset.width_s), ("p", offset.p), ("fit", offset.fit),
                ("beat_s", offset.beat_s), ("seconds", offset.seconds),
            )
        }  # fmt: skip
        return {
            "name": self.name,
            "known": not offset.unknown,
            "unknown": offset.unknown,
            **numbers,
            "rivals": offset.rivals,
            "curves": {name: round(value, 4) for name, value in offset.curves.items()},
            "clips": [
                {"id": clip.id, "music": clip.music, "audio_start_s": None if start is None else str(start)}
                for clip in self.clips
                for start in [self.start_of(clip)]
            ],
        }


@dataclass(frozen=True)
class Alignment:
    """The offsets of a source, a row for each unit."""

    source: Path
    dataset: str
    by: str
    search: Search
    rows: tuple[Aligned, ...]
    rejects: tuple[Reject, ...] = ()
    file: Path | None = None

    @property
    def known(self) -> tuple[Aligned, ...]:
        """Units with a known offset."""
        return tuple(row for row in self.rows if not row.offset.unknown)

    @property
    def shared_s(self) -> tuple[float, float, float] | None:
        """Lower quartile, median and upper quartile of the known offsets, seconds; None below five."""
        values = [row.offset.offset_s for row in self.known if row.offset.offset_s is not None]
        if len(values) < _FEW:
            return None
        low, middle, high = (float(q) for q in np.quantile(values, (0.25, 0.5, 0.75)))
        return low, middle, high

    @property
    def scatter_p(self) -> float | None:
        """Rayleigh's p of the phases of the beat that the known offsets have; None below five. High: no phase."""
        phases = [
            2 * math.pi * o.offset_s / o.beat_s
            for o in (row.offset for row in self.known)
            if o.offset_s is not None and o.beat_s
        ]
        if len(phases) < _FEW:
            return None
        length = math.hypot(sum(map(math.cos, phases)), sum(map(math.sin, phases)))
        return math.exp(-(length**2) / len(phases))

    def notes(self) -> list[str]:
        """Return sentences about the source as a whole."""
        notes = []
        if (shared := self.shared_s) is not None:
            low, middle, high = (f"{1000 * value:+.0f}" for value in shared)
            notes.append(
                f"median of {len(self.known)} offsets {middle} ms (quartiles {low} to {high} ms): what all share is "
                "a delay of the capture, a habit of dancers or of the method, and is not subtracted"
            )
        if (p := self.scatter_p) is not None and p > _SCATTERED:
            notes.append(
                f"the offsets have no common phase of the beat (p {p:.2f}): music and motion may be paired wrongly"
            )
        rivals = [row.name for row in self.known if row.offset.rivals]
        if rivals:
            notes.append(
                f"other songs of the source, of the same tempo, fit too for {listed(rivals)}: the offset is of the "
                "song that the source states; in Python, test_songs=True makes these unknown"
            )
        reasons = {row.offset.unknown for row in self.rows} - {""}
        return notes + [f"unknown, {reason}: {REASONS[reason]}" for reason in REASONS if reason in reasons]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        shared, scatter = self.shared_s, self.scatter_p
        return {
            "source": str(self.source),
            "dataset": self.dataset,
            "by": self.by,
            "window_s": self.search.window_s,
            "level": self.search.level,
            "test_songs": self.search.test_songs,
            "seed": self.search.seed,
            "known": len(self.known),
            "units": [row.to_json() for row in self.rows],
            "shared_s": None if shared is None else [round(value, 4) for value in shared],
            "scatter_p": None if scatter is None else round(scatter, 4),
            "notes": self.notes(),
            "rejects": [reject.to_json() for reject in self.rejects],
            "file": None if self.file is None else str(self.file),
        }

    def to_csv(self) -> str:
        """Return a table with a line for each clip; ``audio_start_s`` is what a manifest states."""
        rows: list[list[object]] = []
        for row in self.rows:
            for clip in row.clips:
                start, o = row.start_of(clip), row.offset
                numbers = ["" if v is None else f"{v:.4f}" for v in (o.offset_s, o.width_s, o.p)]
                beat = "" if o.beat_s is None else f"{o.beat_s:.4f}"
                names = map(csv_cell, (clip.id, row.name, clip.music))  # negative numbers are not formulas
                rows.append([*names, *numbers, o.rivals, beat, o.unknown, "" if start is None else str(start)])
        return csv_text(_CSV, rows)

    def __str__(self) -> str:
        names = (self.by, "clips", "offset ms", "+- ms", "p", "rivals", "beat ms", "s", "")
        lines = [line.rstrip() for line in table(names, [_cells(row) for row in self.rows])]
        counts = f"{len(self.known)} of {counted(len(self.rows), 'offset')} known"
        text = [
            f"{self.source}: {counts}, within {1000 * self.search.window_s:g} ms, p at most {self.search.level:g}"
        ]
        text += lines if self.rows else []
        text += [f"  note: {note}" for note in self.notes()]
        left_out = left_out_lines(self.rejects)
        text += [line if line.startswith(" ") else f"  left out: {line}" for line in left_out]
        return "\n".join([*text, *([f"written to {self.file}"] if self.file else [])])


def _cells(row: Aligned) -> list[object]:
    o = row.offset
    around = "({})" if o.unknown else "{}"
    ms = [
        "-" if v is None else around.format(f"{1000 * v:{form}}")
        for v, form in ((o.offset_s, "+.0f"), (o.width_s, ".0f"))
    ]
    p, beat = "-" if o.p is None else f"{o.p:.3f}", "-" if o.beat_s is None else f"{1000 * o.beat_s:.0f}"
    verdict = f"unknown: {o.unknown}" if o.unknown else ""
    return [row.name, len(row.clips), *ms, p, o.rivals, beat, f"{o.seconds:.1f}", verdict]


def align(
    source: str | Path,
    *,
    by: str = "recording",
    dataset: str | None = None,
    recipe: RecipeLike | None = None,
    overrides: Overrides = (),
    window_s: float = 0.5,
    level: float = 0.02,
    test_songs: bool = False,
    seed: int = 0,
    out: str | Path | None = None,
    jobs: int | None = 1,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Alignment:
    """Estimate the offset between the music and the motion of a source, as ``dancedata check --offsets`` does.

    No file of the source is changed; docs/archive/measured.md has the method and what it finds of planted offsets.

    Parameters
    ----------
    source
        Folder to build from.
    by
        What has one offset: a "recording" (the dancers of a group; parts and people of one motion file), a "clip",
        or a "song", with all clips of it.
    dataset
        Reader of the folder, such as "folder". Default: the first one that recognises it.
    recipe, overrides
        Read the folder as this recipe does. Default: its recipe.yaml, if `dataset` is not given.
    window_s
        Offsets from minus this to this are searched, seconds, from the stated second of the music. Music is periodic:
        an offset is known up to whole beats, and the one nearest to 0 is taken.
    level
        Largest p of a known offset.
    test_songs
        An offset is unknown too if other songs of the source fit.
    seed
        Of the draws. The result depends on nothing else that is not stated here or in the source.
    out
        New .csv file, with a line for each clip.
    jobs, cache, progress
        As in `build`.

    Returns
    -------
    Alignment
        `rows` with an `Offset` each, `notes()`, `to_json()`, `to_csv()`; its text is the table.

    Raises
    ------
    UsageError
        For an unknown `by`, a number out of range, a file that exists, and a built dataset.
    SourceError
        If the folder is not a source of a known dataset.

    Examples
    --------
    >>> import dancedata
    >>> alignment = dancedata.align("~/aist_plusplus_final", by="song", progress=False)
    >>> [(row.name, abs(row.offset.offset_s) < 1 / 60) for row in alignment.known]
    [('mBR0', True), ('mHO3', True)]
    """
    path, file, reporter = Path(source).expanduser(), folder_of(out), Progress(quiet=not progress)
    search = Search(window_s, level, test_songs, seed)
    _check(path, by, search, file)
    parsed, build_cache = chosen_recipe(path, recipe, dataset, overrides), Cache.at(cache)
    reader, scan = scan_folder(path, dataset if parsed is None else parsed.dataset)
    clips = [clip for clip in scan.clips if clip.audio_path is not None]
    units, workers = _units(clips, by), jobs_of(jobs)
    songs = sorted({clip.audio_path for clip in clips if clip.audio_path is not None})
    with running(build_cache.root):
        offsets, rejects = build_cache.retry_lost(
            lambda cache: find_offsets(cache, reader, units, songs, search, jobs=workers, progress=reporter), reporter
        )
    rows = [Aligned(u.name, u.clips, o) for u, o in zip(units, offsets, strict=True) if isinstance(o, Offset)]
    rejects = [*scan.rejects, *(missing_music(clip) for clip in scan.clips if clip.audio_path is None), *rejects]
    relative = tuple(relative_to(reject, path) for reject in rejects)
    result = Alignment(path, reader.name, by, search, tuple(rows), relative)
    if file is None:
        return result
    write_csv(file, result.to_csv())
    return replace(result, file=file)


def _check(path: Path, by: str, search: Search, file: Path | None) -> None:
    if by not in BY:
        raise UsageError("unknown value of by", found=repr(by), allowed=did_you_mean(by, BY))
    if not 0.05 <= search.window_s <= 10:
        raise UsageError("window is out of range", found=search.window_s, allowed="0.05 to 10 seconds")
    if not 0 < search.level < 1:
        raise UsageError("level is out of range", found=search.level, allowed="above 0, below 1")
    require_new_csv(file)
    if (path / DATASET_FILE).exists():
        raise UsageError("a built dataset has no music to compare with", where=path,
                         fix="give the folder that it was built from")  # fmt: skip


def _units(clips: Sequence[ClipRef], by: str) -> list[OffsetGroup]:
    if by == "recording":
        return recordings(clips)
    if by == "clip":
        return [OffsetGroup(clip.id, (clip,)) for clip in clips]
    songs: dict[tuple[str, Path | None], list[ClipRef]] = {}
    for clip in clips:
        songs.setdefault((clip.music, clip.audio_path), []).append(clip)
    return [OffsetGroup(of[0].music or of[0].id, tuple(of)) for of in songs.values()]
