"""The figures of the alignment of single clips and songs."""

from collections.abc import Sequence

import numpy as np

from dancedata.core.text import counted
from dancedata.pages.document import ALIGNED, SHIFTED_MS, ClipRow, SongShift
from dancedata.pages.figures import FigureSpec
from dancedata.pages.markup import Figure, escaped, number, rounded
from dancedata.pages.svg import bars, drawn, points

#: Songs that are drawn.
_SONGS = 40
#: Size of the rows of songs, units of the page's text.
_NAMES, _ROOM, _ROW = 128.0, 230.0, 15.0


def rhythm_figures(d: FigureSpec) -> list[Figure]:
    """Return the alignment of clips against their chance, by clip and genre, and the offsets of each song."""
    rows = [row for row in d.numbers.clips if row.numbers.bas is not None and row.numbers.bas_chance is not None]
    figures = [_by_clip(d, rows), _by_genre(rows)] if rows else []
    songs = [song for song in d.numbers.music.songs if song.key_motions]
    return [*figures, _offsets(d, songs)] if songs else figures


def _gain(row: ClipRow) -> float:
    return (row.numbers.bas or 0.0) - (row.numbers.bas_chance or 0.0)


def _by_clip(d: FigureSpec, rows: Sequence[ClipRow]) -> Figure:
    below = sum(_gain(row) <= 0 for row in rows)
    clips = f"{below} of {counted(len(rows), 'clip')}"
    note = f"{clips} at or below their own chance (the diagonal); the worst first in the numbers"
    pairs = [(row.numbers.bas_chance or 0.0, row.numbers.bas or 0.0, row.clip) for row in rows]
    head = ("clip", "genre", "song", "score", "chance", "difference")
    table_rows = tuple(
        (d.link(row.clip), row.genre, row.song, row.numbers.bas, row.numbers.bas_chance, _gain(row))
        for row in sorted(rows, key=lambda row: (_gain(row), row.clip))
    )
    body = points(pairs, ("chance", "beat alignment score"))
    return Figure("bas_clips", "Alignment of each clip", note, body, head, table_rows, sortable=True)


def _mean(values: Sequence[float | None]) -> float:
    return float(np.mean([value or 0.0 for value in values]))


def _by_genre(rows: Sequence[ClipRow]) -> Figure:
    genres: dict[str, list[ClipRow]] = {}
    for row in rows:
        genres.setdefault(row.genre or "unknown", []).append(row)
    means = {
        genre: (_mean([r.numbers.bas for r in of]), _mean([r.numbers.bas_chance for r in of]))
        for genre, of in sorted(genres.items(), key=lambda item: (-_mean(list(map(_gain, item[1]))), item[0]))
    }
    body = bars({g: {"": round(score, 3)} for g, (score, _) in means.items()}, "beat alignment score by genre",
                other={g: round(chance, 3) for g, (_, chance) in means.items()})  # fmt: skip
    table_rows = tuple((genre, len(genres[genre]), *both) for genre, both in means.items())
    note = "mean over clips, those farthest above chance first; in brackets: chance"
    return Figure("bas_genre", "Alignment by genre", note, body, ("genre", "clips", "score", "chance"), table_rows,
                  other="chance")  # fmt: skip


def _offsets(d: FigureSpec, songs: Sequence[SongShift]) -> Figure:
    edges = d.numbers.music.offset_ms.edges
    shown = songs[:_SONGS]
    more = f"; the first {len(shown)} of {len(songs)}" if len(songs) > len(shown) else ""
    note = (
        "key motions after the nearest beat, a row for each song, dark where many are; mark: mean on the circle of a "
        f"beat. A song beyond {SHIFTED_MS:g} ms on which the dancers agree (strength above {ALIGNED:g}) has probably "
        f"its audio at the wrong time{more}"
    )
    span = edges[-1] - edges[0]

    def x(ms: float) -> float:
        return _NAMES + (min(max(ms, edges[0]), edges[-1]) - edges[0]) / span * _ROOM

    bottom = 4 + _ROW * len(shown)
    body = f'<path class="grid" d="M{x(0):.1f} 0V{bottom}"/>'
    for k, song in enumerate(shown):
        y, most = 4 + k * _ROW, max(song.counts) or 1
        name = song.song if len(song.song) <= 18 else f"{song.song[:17]}…"
        body += f'<text x="{_NAMES - 7:.0f}" y="{y + 10}" text-anchor="end">{escaped(name)}</text>'
        for low, high, n in zip(edges, edges[1:], song.counts, strict=False):
            if n:
                box = f'x="{x(low):.1f}" y="{y}" width="{x(high) - x(low) - 0.5:.1f}" height="12"'
                body += f'<rect class="s0" fill-opacity="{n / most:.2f}" {box}/>'
        kind = "shift bad" if song.is_shifted else "shift"
        body += f'<path class="{kind}" d="M{x(song.shift_ms):.1f} {y - 1}v14"/>'
        text = f"{rounded(song.shift_ms)} ms"
        body += f'<text x="{_NAMES + _ROOM + 6:.0f}" y="{y + 10}" text-anchor="start" class="value">{text}</text>'
    for ms in (edges[0], 0.0, edges[-1]):
        body += f'<text x="{x(ms):.1f}" y="{bottom + 14:.0f}" text-anchor="middle">{number(round(ms))}</text>'
    head = ("song", "clips", "key motions", "shift ms", "strength")
    rows = tuple((s.song, s.clips, s.key_motions, s.shift_ms, s.strength) for s in songs)
    return Figure(
        "song_offsets", "Offset of each song", note, drawn(body, "offsets by song", bottom + 20), head, rows
    )
