"""write_report: a dataset as a page and as numbers, and the files of the page."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.text import shown
from dancedata.files.page_files import PageFiles
from dancedata.kernel import Progress, Store, open_store
from dancedata.pages.document import SCHEMA, Document
from dancedata.pages.figures import FigureSpec
from dancedata.pages.heat import Timeline, heat_map, joint_map
from dancedata.pages.markup import Figure
from dancedata.pages.measure import measure
from dancedata.pages.numbers import document
from dancedata.pages.page import page
from dancedata.pages.player import Player, clip_player, embedded_sound
from dancedata.pages.scales import Scales
from dancedata.scene.pieces import ClipReader
from dancedata.scene.stills import middle_still

#: Number of clips of a page.
Clips = int | Literal["all", "none"]
#: Clips whose paths are drawn.
_PATHS = 12


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes
    ----------
    numbers
        Every number of the page.
    other_numbers
        Those of the dataset it is compared with.
    differences
        Between both datasets, as `dancedata.comparison.diff` returns them; None: not looked for.
    path
        The page; None if none was written.
    """

    numbers: Document
    other_numbers: Document | None = None
    differences: Any = None
    path: Path | None = None

    @property
    def document(self) -> dict[str, Any]:
        """Every number of the page as plain JSON data; described in docs/reference/commands.md."""
        return self.numbers.to_json()

    @property
    def other(self) -> dict[str, Any] | None:
        """The same of the dataset it is compared with."""
        return None if self.other_numbers is None else self.other_numbers.to_json()

    def __repr__(self) -> str:
        name, totals = shown(self.numbers.about.name), self.numbers.totals
        page_of = "" if self.path is None else f", {str(self.path)!r}"
        return f"Report({name}: {totals.clips} clips, {totals.windows} windows{page_of})"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "schema": SCHEMA,
            "path": None if self.path is None else str(self.path),
            "report": self.document,
            "against": self.other,
            "differences": [d.to_json() for d in self.differences or ()],
        }


@dataclass(frozen=True)
class _PageOptions:
    target: PageFiles
    clips: Clips
    embed_audio: bool
    source: Path | None
    rights: str | None


def write_report(
    store: str | Path,
    to: str | Path | None = None,
    *,
    clips: Clips = 12,
    audio: Literal["none", "embed"] = "none",
    source: str | Path | None = None,
    rights: str | None = None,
    against: str | Path | None = None,
    differences: Callable[[Path, Path], Any] | None = None,
    max_mb: float = 20,
    overwrite: bool = False,
    progress: bool = False,
) -> Report:
    """Summarise a built dataset, as ``dancedata report`` does.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        HTML file to write; None: numbers alone.
    clips
        Number of clips or groups that the page plays, "all" or "none": half of them the most suspicious, the others
        spread over the genres. The first 12 are inside the page, the others in a folder next to it.
    audio
        "embed": with the music of the clips inside the page.
    source
        Folder with the music.
    rights
        Why the caller may pass the music on where the dataset's licence does not allow it; it is published.
    against
        Another dataset to compare with.
    differences
        What finds the differences of both, such as `dancedata.comparison.diff`. Default: they are not listed.
    max_mb
        Largest page, megabytes.
    overwrite
        Replace an existing page.
    progress
        Show progress on stderr.

    Returns
    -------
    Report
        Equal datasets give equal numbers and equal bytes of the page.

    Raises
    ------
    UsageError
        If the file exists, is inside a dataset, or would be larger than `max_mb`; if the licence does not allow
        the music to be passed on.
    DataError, StoreError
        If a dataset is damaged, or the page cannot be written.
    """
    with ExitStack() as open_stores:
        stores = [open_stores.enter_context(open_store(path)) for path in (store, against) if path is not None]
        options, places = None, [opened.path for opened in stores]
        if to is not None:
            target = PageFiles.of(Path(to), places, max_mb=max_mb, overwrite=overwrite)
            folder = None if source is None else Path(source)
            options = _PageOptions(target, _checked(clips), _embeds(audio), folder, rights)
        for opened in stores:
            opened.require_intact()
        reporter = Progress(quiet=not progress)
        measured = [measure(opened, reporter) for opened in stores]
        scales = Scales.of(measured)
        compared = None if differences is None or against is None else differences(*places)
        numbers, *beside = (document(of_store, scales) for of_store in measured)
        return _report(measured[0].reader, numbers, beside[0] if beside else None, compared, options)


def _checked(clips: Clips) -> Clips:
    if clips in ("all", "none") or (isinstance(clips, int) and clips >= 0):
        return clips
    raise UsageError("not a number of clips", found=shown(clips), allowed='a number >= 0, "all" or "none"')


def _embeds(audio: str) -> bool:
    if audio not in ("none", "embed"):
        raise UsageError("unknown audio", found=shown(audio), allowed='"none" or "embed"')
    return audio == "embed"


def _report(
    reader: ClipReader, numbers: Document, other: Document | None, differences: Any, options: _PageOptions | None
) -> Report:
    if options is None:
        return Report(numbers, other, differences)
    store = reader.store
    player = _player(store, numbers, options)
    texts = None
    if differences is not None:
        texts = [(kind, text) for kind, _, text in (line.partition(": ") for line in differences.lines())]
    chosen = _spread(numbers, _PATHS)
    heat_maps, stills = _heat_maps(store, numbers, reader), _stills(store, reader, chosen)
    drawing = FigureSpec(numbers, other, player.links, player.group_links, player.lists)
    html = page(drawing, chosen, store.fields, heat_maps, stills, texts, player)
    options.target.write(html.encode(), player.side_files())
    return Report(numbers, other, differences, options.target.path)


def _player(store: Store, numbers: Document, options: _PageOptions) -> Player:
    n = {"all": len(numbers.clips), "none": 0}.get(str(options.clips), options.clips)
    clips = _spread(numbers, int(n))
    sound = embedded_sound(store, clips, options.source, rights=options.rights) if options.embed_audio else None
    return clip_player(store, clips, options.target.folder.name, sound)


def _spread(numbers: Document, n: int) -> list[str]:
    """Return up to `n` clips to show: half of them the first of the ranking, the others spread over the genres."""
    unit = {row.clip: (row.group, "" if row.group else row.clip) for row in numbers.clips}
    suspects = {unit[suspect.clip]: suspect.clip for suspect in reversed(numbers.ranking)}
    ranked = list(dict.fromkeys(unit[suspect.clip] for suspect in numbers.ranking))[: (n + 1) // 2]
    first = [suspects[key] for key in ranked]
    by_genre: dict[str, list[str]] = {}
    seen = set(ranked)
    for row in numbers.clips:
        if unit[row.clip] not in seen:
            seen.add(unit[row.clip])
            by_genre.setdefault(row.genre, []).append(row.clip)
    turns = zip_longest(*(by_genre[genre] for genre in sorted(by_genre)))
    return [*first, *(clip for turn in turns for clip in turn if clip is not None)][:n]


def _heat_maps(store: Store, numbers: Document, reader: ClipReader) -> dict[str, Figure]:
    """Return the heat map of each field, of the longest clip: of motion the speed of each joint above the columns."""
    if not numbers.clips:
        return {}
    clip = max(numbers.clips, key=lambda row: (row.frames, row.clip)).clip
    piece = reader.piece(store[clip])
    beats = () if piece is None or piece.beat_times is None else tuple(piece.beat_times.tolist())
    figures = {}
    for name, columns in store.fields.items():
        if name not in store[clip]:
            continue
        rows = store[clip].rows_within(name)[1]
        if not len(rows):
            continue
        time = Timeline(len(rows) / float(store.field(name).grid.rate), beats)
        body = heat_map(rows, columns, f"columns of {name} over time", time)
        note, joints = f"clip {shown(clip)}; seconds, with marks at the beats", ""
        if piece is not None and reader.motion is not None and name == reader.motion.name:
            figure = piece.figure
            speed = np.linalg.norm(np.diff(figure.joints, axis=0), axis=2) * piece.rate
            joints = joint_map(speed, figure.skeleton.joints, time, "speed of the joints over time")
            note += "; speed of each joint, light where it is fast"
        key = "a line for each column, dark at its 2nd percentile, light at its 98th"
        fold = f"<details><summary>all columns</summary><p>{key}</p>{body}</details>"
        figures[name] = Figure(f"heat_{name}", f"{name} over time", note, joints + fold, kind="wide")
    return figures


def _stills(store: Store, reader: ClipReader, clips: Sequence[str]) -> list[tuple[str, str]]:
    """Return the pose in the middle of each clip, facing the reader."""
    stills = []
    for clip in clips:
        piece = reader.piece(store[clip])
        if piece is not None and len(piece.figure.joints):
            stills.append((clip, middle_still(piece.figure, f"a pose of {clip}")))
    return stills


def default_path(store: str | Path) -> Path:
    """Return NAME-report.html in the current folder; for invalid file names only the usual characters."""
    with open_store(store) as opened_store:
        name = "".join(
            c if c.isascii() and (c.isalnum() or c in "._+-") else "_" for c in opened_store.info.get("name", "")
        )
    return Path(f"{name.lstrip('.') or 'dataset'}-report.html")
