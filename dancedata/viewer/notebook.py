"""What notebooks show: motions and clips as players, datasets and lists of clips as tables with stills."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Any

from dancedata.core.errors import DanceDataError
from dancedata.core.motion import Motion
from dancedata.core.text import counted, shown
from dancedata.kernel import Clip, Clips, Store
from dancedata.scene.motion_page import Page, view_motions
from dancedata.scene.page import clip_page
from dancedata.scene.scenes import Scenes
from dancedata.scene.stills import middle_still

#: Clips that a table shows, and the height of a still, pixels.
MOST_CLIPS, _STILL = 8, 64


def html_of(value: Any) -> str:
    """Return what a notebook shows: of a motion or clip a player, of clips or a dataset tables with stills."""
    if hasattr(value, "cells"):
        return _scores(value)
    if isinstance(value, Store):
        return store_html(value)
    if isinstance(value, Clips):
        return clips_html(value)
    if isinstance(value, Motion):
        return view_motions(value)._repr_html_()
    if not isinstance(value, Clip) or not isinstance(value.store, Store):
        return f"<pre>{html.escape(str(value))}</pre>"
    scenes = Scenes(value.store)
    return Page(repr(value), clip_page(scenes, scenes.items_of(value.id)))._repr_html_()


def _scores(report: Any) -> str:
    """Return the table of an evaluation's scores, with its verdict."""
    head, rows = report.cells()
    void = [score.verdict == "void" for score in report.scores]
    body = "".join(
        f"<tr{' style=opacity:.5' * is_void}>{''.join(f'<td>{_text(cell)}</td>' for cell in row)}</tr>"
        for is_void, row in sorted(zip(void, rows, strict=True), key=lambda pair: pair[0])
    )
    names = "".join(f"<th>{_text(name)}</th>" for name in head)
    return f"<p><b>{_text(report.verdict)}</b></p><table><tr>{names}</tr>{body}</table>"


def store_html(store: Store) -> str:
    """Return a dataset as an element: name, splits, fields, licence, and its first clips."""
    counted_by = store.info["splits"]
    kinds = [kind for kind in ("clips", "groups", "windows") if any(kind in counts for counts in counted_by.values())]
    splits = [
        (split, *(counts.get(kind, "") for kind in kinds), f"{round(60 * counts['hours'], 6):.1f}")
        for split, counts in counted_by.items()
    ]
    fields = [
        (name, store.field(name).kind, columns.width, str(store.field(name).rate))
        for name, columns in store.fields.items()
    ]
    head = f"<b>{_text(store.info.get('name', store.path.name))}</b> &middot; {_text(store.path)}"
    head += f" &middot; {store.grid} frames per second"
    return (
        f"<div><p>{head}</p>"
        f"{_table(('split', *kinds, 'minutes'), splits)}"
        f"{_table(('field', 'kind', 'columns', 'rows per second'), fields)}"
        f"<p>{_text(store.info.get('licence', ''))}</p>{clips_html(store.clips()[:MOST_CLIPS], len(store))}</div>"
    )


def clips_html(clips: Clips, total: int | None = None) -> str:
    """Return a list of clips as an element: the first ones with a still from their middle."""
    first = list(clips[:MOST_CLIPS])
    if not first:
        return "<p>no clips</p>"
    store: Any = first[0].store  # a Store, of which a clip knows only how to read
    scenes = Scenes(store)
    rows = [
        (
            _Kept(_still(scenes, clip)), clip.id, clip.split, clip.genre, clip.music, clip.dancer,
            f"{float(clip.store.grid.seconds(clip.n_frames)):.2f} s",
        )
        for clip in first
    ]  # fmt: skip
    left = (total or len(clips)) - len(first)
    more = f"<p>and {counted(left, 'more clip')}</p>" if left > 0 else ""
    return _table(("", "clip", "split", "genre", "song", "dancer", "length"), rows) + more


class _Kept(str):
    """Markup that a table keeps as it is."""


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    top = "".join(f"<th>{_text(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{c if isinstance(c, _Kept) else _text(c)}</td>" for c in row) + "</tr>" for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _text(value: object) -> str:
    return html.escape(shown(value, 120), quote=True)


def _still(scenes: Scenes, clip: Clip) -> str:
    """Return the pose in the middle of a clip, from the front, as SVG; "" where it cannot be drawn."""
    try:
        figure = scenes.scene(scenes.items_of(clip.id)[0]).figure
    except DanceDataError:
        return ""
    return "" if figure is None else middle_still(figure, "a pose", _STILL)
