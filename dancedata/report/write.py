"""write_report: a dataset as a page and as numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dancedata.core.errors import UsageError
from dancedata.core.text import shown
from dancedata.pipeline.diff import Difference, diff
from dancedata.report.document import SCHEMA, Document, document
from dancedata.report.figures import Drawing
from dancedata.report.left_out import spread
from dancedata.report.markup import Figure, number
from dancedata.report.measure import measure
from dancedata.report.page import PageParts, page
from dancedata.report.pictures import heat_map
from dancedata.report.player import Player, clip_player, embedded_sound
from dancedata.report.scales import Scales
from dancedata.report.target import Target
from dancedata.store import Store, open_store

#: How many clips a page has.
Clips = int | Literal["all", "none"]
#: Clips whose paths are drawn.
_PATHS = 12


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes
    ----------
    document
        Every number of the page; docs/report.md says what they are.
    other
        Those of the dataset it is compared with.
    differences
        Between both datasets.
    path
        The page; None if none was written.
    """

    document: Document
    other: Document | None = None
    differences: tuple[Difference, ...] = ()
    path: Path | None = None

    def __repr__(self) -> str:
        record, totals = self.document["about"], self.document["totals"]
        page_of = "" if self.path is None else f", {str(self.path)!r}"
        return f"Report({shown(record['name'])}: {totals['clips']} clips, {totals['windows']} windows{page_of})"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "schema": SCHEMA,
            "path": None if self.path is None else str(self.path),
            "report": self.document,
            "against": self.other,
            "differences": [d.to_json() for d in self.differences],
        }


@dataclass(frozen=True)
class _Page:
    """Options of the page."""

    target: Target
    clips: Clips
    embed_audio: bool
    source: Path | None
    may_share: bool


def write_report(
    store: str | Path,
    to: str | Path | None = None,
    *,
    clips: Clips = 12,
    audio: Literal["none", "embed"] = "none",
    source: str | Path | None = None,
    may_share: bool = False,
    against: str | Path | None = None,
    max_mb: float = 20,
    overwrite: bool = False,
) -> Report:
    """Summarise a built dataset, as ``dancedata report`` does.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        HTML file to write; None: numbers alone.
    clips
        Number of clips that the page plays, "all" or "none": half of them the most suspicious, the others spread over
        the genres. The first 12 are inside the page, the others in a folder beside it.
    audio
        "embed": with the music of the clips inside the page.
    source
        Folder with the music.
    may_share
        The caller states to have the right to pass the music on, where the dataset's licence does not allow it.
    against
        Another dataset, whose numbers stand beside those of this one.
    max_mb
        Largest page, megabytes.
    overwrite
        Replace a page that is there.

    Returns
    -------
    Report
        Equal datasets give equal numbers and equal bytes of the page.

    Raises
    ------
    UsageError
        If the file is there, lies inside a dataset, or would be larger than `max_mb`; if the licence does not allow
        the music to be passed on.
    DataError, StoreError
        If a dataset is damaged, or the page cannot be written.
    """
    wanted = None
    if to is not None:
        stores = [Path(path) for path in (store, against) if path is not None]
        target = Target.of(Path(to), stores, max_mb=max_mb, overwrite=overwrite)
        folder = None if source is None else Path(source)
        wanted = _Page(target, _checked(clips), _embeds(audio), folder, may_share)
    with open_store(store) as opened_store:
        opened_store.require_intact()
        measured = measure(opened_store)
        if against is None:
            return _made(opened_store, document(measured, Scales.of([measured])), None, (), wanted)
        with open_store(against) as other:
            other.require_intact()
            beside = measure(other)
            scales = Scales.of([measured, beside])
            differences = tuple(diff(opened_store.path, other.path))
            return _made(opened_store, document(measured, scales), document(beside, scales), differences, wanted)


def _checked(clips: Clips) -> Clips:
    if clips in ("all", "none") or (isinstance(clips, int) and clips >= 0):
        return clips
    raise UsageError("not a number of clips", found=shown(clips), allowed='a number >= 0, "all" or "none"')


def _embeds(audio: str) -> bool:
    if audio not in ("none", "embed"):
        raise UsageError("unknown audio", found=shown(audio), allowed='"none" or "embed"')
    return audio == "embed"


def _made(
    store: Store, this: Document, other: Document | None, differences: tuple[Difference, ...], wanted: _Page | None
) -> Report:
    if wanted is None:
        return Report(this, other, differences)
    player = _player(store, this, wanted)
    html = _page(store, this, other, differences, player)
    wanted.target.write(html.encode(), player)
    return Report(this, other, differences, wanted.target.path)


def _player(store: Store, this: Document, wanted: _Page) -> Player:
    n = {"all": len(this["clips"]), "none": 0}.get(str(wanted.clips), wanted.clips)
    clips = spread(this, int(n))
    sound = None
    if wanted.embed_audio:
        sound = embedded_sound(store, clips, wanted.source, may_share=wanted.may_share)
    return clip_player(store, clips, wanted.target.folder.name, sound)


def _page(
    store: Store, this: Document, other: Document | None, differences: Sequence[Difference], player: Player
) -> str:
    texts = [(d.kind, str(d).partition(": ")[2]) for d in differences]
    parts = PageParts(spread(this, _PATHS), store.fields, _heat_maps(store, this), texts, player)
    return page(Drawing(this, other, player.links), parts)


def _heat_maps(store: Store, this: Document) -> dict[str, Figure]:
    """Return the heat map of each field, of the longest clip."""
    if not this["clips"]:
        return {}
    clip = max(this["clips"], key=lambda row: (row["frames"], row["clip"]))["clip"]
    windows = store.windows_of(clip)
    if store.scope == "window" and not windows:
        return {}
    figures = {}
    for name, columns in store.fields.items():
        rows = store.read_clip(clip, name) if store.scope == "track" else store.read(windows[0], name)
        if not len(rows):
            continue
        seconds = number(len(rows) / float(store.field(name).grid.rate))
        note = (
            f"clip {shown(clip)}; from left to right {seconds} s; a line for each column, "
            "dark at its 2nd percentile, light at its 98th"
        )
        body = heat_map(rows, columns, f"columns of {name} over time")
        figures[name] = Figure(f"heat_{name}", f"{name} over time", note, body, kind="wide")
    return figures


def default_path(store: str | Path) -> Path:
    """Return NAME-report.html in the current folder; of names that are no file names only the usual characters."""
    with open_store(store) as opened_store:
        name = "".join(
            c if c.isascii() and (c.isalnum() or c in "._+-") else "_" for c in opened_store.meta.get("name", "")
        )
    return Path(f"{name.lstrip('.') or 'dataset'}-report.html")
