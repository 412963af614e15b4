"""The figures of a report, drawn from its document and nothing else, in the order of a reader's questions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from dancedata.core.text import counted, listed
from dancedata.pages.bin_counts import ClipHistogram, Histogram
from dancedata.pages.document import Counts, Document, Shared
from dancedata.pages.markup import Figure, Markup, escaped, name_text, number, rounded, table
from dancedata.pages.svg import bars, boxes, histogram, paths, points

#: Most bars of a chart; the table below it has all of them.
_BARS = 40
#: Paths that are drawn.
_PATHS = 12
#: Share of standing still that is mentioned.
_MUCH_STILL = 0.02

_T = TypeVar("_T")


@dataclass(frozen=True)
class FigureSpec:
    """Numbers that figures are drawn from."""

    numbers: Document
    other: Document | None = None  # the document of the dataset it is compared with
    # `links`, `group_links`, `lists`: address of the clips and groups that the page plays, and of its lists of a
    # genre, song or dancer, for HTML
    links: Mapping[str, Markup] | None = None
    group_links: Mapping[str, Markup] | None = None
    lists: Mapping[str, Markup] = field(default_factory=dict)

    @property
    def other_names(self) -> tuple[str, ...]:
        """Name of the other dataset as a column of tables; empty without one."""
        return () if self.other is None else (self.other.about.name,)

    @property
    def outline(self) -> str:
        """Name of the other dataset in legends; "" without one."""
        return "" if self.other is None else f"outline: {self.other.about.name}"

    def link(self, clip: str, text: str = "") -> Markup:
        """Return the name of a clip, or another text, as a link where the page has the clip."""
        return _linked((self.links or {}).get(clip), text or clip)

    def group_link(self, group: str) -> Markup:
        """Return the name of a group, as a link where the page has it."""
        return _linked((self.group_links or {}).get(group), group)

    def both(self, part: Callable[[Document], _T]) -> tuple[_T, _T | None]:
        """Return a part of the document and of the other one."""
        return part(self.numbers), None if self.other is None else part(self.other)


def _linked(address: Markup | None, text: str) -> Markup:
    if address is None:
        return Markup(f'<span class="clip">{name_text(text)}</span>')
    return Markup(f'<a href="{address}">{name_text(text)}</a>')


def histogram_figure(
    d: FigureSpec,
    key: str,
    part: Callable[[Document], Histogram],
    title: str,
    note: str,
    label: str,
    marks: Sequence[tuple[float, str]] = (),
    *,
    of: str = "clips",
) -> Figure:
    """Return a histogram of this dataset, with the other one as outline; else with a line for each split."""
    this, other = d.both(part)
    values = [h.distinct for h in (this, other) if isinstance(h, ClipHistogram)]
    if values and all(values):
        return Figure(key, title, note, _sentence(d, values, label))
    note = f"% of {of}; {note}".removesuffix("; ")
    groups = this.counts
    lines = {split: counts for split, counts in this.by_split.items() if any(counts)} if other is None else {}
    if len(lines) > 1:
        body = histogram(this.edges, groups, label, lines=lines, marks=marks)
        rows = tuple(zip(this.edges, this.edges[1:], *groups.values(), *lines.values(), strict=False))
        return Figure(key, title, note, body, ("from", "to", *groups, *lines), rows, tuple(lines))
    outline = None if other is None else [sum(column) for column in zip(*other.counts.values(), strict=True)]
    body = histogram(this.edges, groups, label, other=outline, marks=marks)
    columns = [*groups.values(), *([] if outline is None else [outline])]
    rows = tuple(zip(this.edges, this.edges[1:], *columns, strict=False))
    legend = tuple(groups) if len(groups) > 1 else ()
    return Figure(key, title, note, body, ("from", "to", *groups, *d.other_names), rows, legend, d.outline)


def _sentence(d: FigureSpec, values: Sequence[Sequence[tuple[float, int]]], unit: str) -> str:
    """Return one or two values of clips in words."""
    texts = [listed([f"{number(value)} {unit} in {counted(n, 'clip')}" for value, n in counts]) for counts in values]
    return "".join(
        f"<p>{escaped(text)}{name}</p>" for text, name in zip(texts, ("", *map(_in, d.other_names)), strict=False)
    )


def _in(name: str) -> str:
    return f" <small>({escaped(name)})</small>"


def bar_figure(
    d: FigureSpec,
    key: str,
    part: Callable[[Document], Counts],
    title: str,
    note: str,
    first: str,
    *,
    legend: bool = True,
) -> Figure:
    """Return bars by name and group, the sums of the other dataset as outlines."""
    this, other = d.both(part)
    totals = None if other is None else {name: sum(values.values()) for name, values in other.items()}
    names = [*this, *(name for name in totals or {} if name not in this)]
    if len(names) > _BARS:
        note = f"{note}; the first {_BARS} of {len(names)}".removeprefix("; ")
    groups = tuple(next(iter(this.values()), {}))
    rows = tuple(
        (
            name,
            *(this.get(name, {}).get(g, 0) for g in groups),
            *([] if totals is None else [totals.get(name, 0)]),
        )
        for name in names
    )
    drawn = {name: this.get(name, {}) for name in names[:_BARS]}
    n, n_other = sum(sum(values.values()) for values in this.values()), sum((totals or {}).values())
    if totals is None or n == n_other:
        body = bars(drawn, title, other=totals, links=d.lists)
    else:
        note = f"% of each dataset's sum, {n:,} and {n_other:,}; {note}".removesuffix("; ")
        shares = {name: shares_of(values, n) for name, values in drawn.items()}
        body = bars(shares, title, other=shares_of(totals, n_other), unit=" %", links=d.lists)
    return Figure(key, title, note, body, (first, *groups, *d.other_names), rows, groups if legend else (), d.outline)


def _folded(figure: Figure) -> Figure:
    """Return a figure of many names with its chart behind a fold."""
    if len(figure.rows) <= _BARS:
        return figure
    return replace(figure, body=f"<details><summary>chart</summary>{figure.body}</details>")


def shares_of(counts: Mapping[str, float], total: float) -> dict[str, float]:
    """Return counts as per cent of a total."""
    return {name: 100 * n / total if total else 0.0 for name, n in counts.items()}


def contents_figures(d: FigureSpec) -> list[Figure]:
    """Return the figures of windows by split, genre, dancer and song, and of lengths, tempos and music."""
    contents, totals = d.numbers.contents, d.numbers.totals
    rates = (f"{rate} in {counted(count, 'clip')}" for rate, count in contents.source_rates.items())
    length_note = f"frames per second of the files: {', '.join(rates)}"
    alike = "; ".join(" and ".join(names) for names in contents.alike)
    genres = f"spelt differently, probably the same: {alike}" if alike else "coloured by split"
    splits_note, songs_note = "what a trainer draws from", "two colours: a song that splits share"
    figures = [
        bar_figure(d, "windows_by_split", lambda n: n.contents.windows_by_split, "Windows by split", splits_note,
                   "split", legend=False),
        bar_figure(d, "windows_by_genre", lambda n: n.contents.windows_by_genre, "Windows by genre", genres, "genre"),
        _folded(bar_figure(d, "windows_by_song", lambda n: n.contents.windows_by_song, "Windows by song", songs_note,
                           "song")),
        histogram_figure(d, "length_s", lambda n: n.contents.length_s, "Length of clips", length_note, "seconds"),
    ]  # fmt: skip
    if totals.dancers:
        dancers = bar_figure(
            d, "windows_by_dancer", lambda n: n.contents.windows_by_dancer, "Windows by dancer", "", "dancer"
        )
        figures.insert(2, dancers)
    if contents.tempo_bpm.n:
        note = f"{contents.tempo_bpm.n} of {totals.clips} clips state one"
        figures.append(
            histogram_figure(d, "tempo_bpm", lambda n: n.contents.tempo_bpm, "Tempo", note, "beats per minute")
        )
    gaps = contents.music_minus_motion_s
    if gaps.n:
        short = len(gaps.shorter)
        note = f"{short} of {gaps.n} clips have less music than motion" if short else "no clip outlasts its music"
        left = f"{rounded(gaps.p50)} s in the median clip, {rounded(gaps.min)} to {rounded(gaps.max)} s"
        figures.append(
            Figure("music_minus_motion_s", "Music that is left after the clip", note, f"<p>{escaped(left)}</p>")
        )
    return figures


def movement_figures(d: FigureSpec, chosen: Sequence[str]) -> list[Figure]:
    """Return the figures of speeds, paths, turns, floor and feet; `chosen` has the clips whose paths are drawn."""
    moves = d.numbers.movement
    if moves.field is None:
        return []
    speed, still, floor, sliding = moves.speed_m_s, moves.still.p50, moves.floor_m, moves.sliding_m_s
    marks = [] if speed.p50 is None else [(speed.p50, f"median {rounded(speed.p50)} m/s")]
    note = f"mean over {moves.joints} joints of {moves.field}; median {rounded(speed.p50)} m/s"
    if still is not None and still >= _MUCH_STILL:
        note += f"; half of the clips stand still in more than {100 * still:.0f}\xa0% of their frames"
    low, high = rounded(floor.min), rounded(floor.max)
    heights = low if low == high else f"{low} to {high}"
    figures = [
        histogram_figure(d, "speed_m_s", lambda n: n.movement.speed_m_s, "Speed of the body", note,
                         "metres per second", marks, of="frames"),
        _joint_speed(d),
        histogram_figure(d, "root_extent_m", lambda n: n.movement.root_extent_m, "Floor that a clip covers",
                         "larger of the two horizontal extents of the root's path", "metres"),
        _paths(d, chosen),
        histogram_figure(d, "turns", lambda n: n.movement.turns, "Turn of the body",
                         "largest turn of the hips within a clip", "full turns"),
        histogram_figure(d, "floor_m", lambda n: n.movement.floor_m, "Height of the floor",
                         f"soles of toes in contact: {heights} m; feet from {number(moves.feet_m.min)} m", "metres"),
    ]  # fmt: skip
    if moves.contact:
        figures.append(_contacts(d))
    if sliding.share_above is not None:
        limit = f"{sliding.above_m_s} m/s"
        note = (
            "horizontal speed of feet that are labelled as standing; "
            f"{100 * sliding.share_above:.1f}\xa0% of them above {limit}"
        )
        figures.append(
            histogram_figure(d, "sliding_m_s", lambda n: n.movement.sliding_m_s, "Sliding in contact", note,
                             "metres per second", [(sliding.above_m_s, limit)], of="frames of feet in contact")
        )  # fmt: skip
    return figures


def _joint_speed(d: FigureSpec) -> Figure:
    this, other = d.both(lambda n: n.movement.joint_speed_m_s)
    named = {name.replace("_", " "): q for name, q in this.items()}
    beside = {name.replace("_", " "): q for name, q in (other or {}).items()}
    rows = tuple(
        (name, *vars(q).values(), *([beside[name].p50 if name in beside else None] if beside else []))
        for name, q in named.items()
    )
    sides = {
        name: "left" if name.startswith("left") else "right" if name.startswith("right") else "mid" for name in named
    }
    median = [f"p50, {name}" for name in d.other_names] if beside else []
    head = ("joint", "p5", "p25", "p50", "p75", "p95", *median)
    note = "line: 5 to 95 % of frames, box: 25 to 75 %, mark: median; blue is left, orange is right"
    body = boxes(named, "metres per second", classes=sides, other=beside)
    return Figure("joint_speed", "Speed by joint", note, body, head, rows, other=d.outline if beside else "")


def _paths(d: FigureSpec, chosen: Sequence[str]) -> Figure:
    all_paths = d.numbers.movement.paths_m
    clips = [clip for clip in chosen if clip in all_paths] or list(all_paths)
    drawn = {clip: all_paths[clip] for clip in clips[:_PATHS]}
    reach = max((abs(v) for path in drawn.values() for point in path for v in point), default=0.0)
    note = f"seen from above, from the filled point to the ring; each square is {rounded(2 * reach)} m wide"
    return Figure(
        "paths", "Paths of the root", note, paths(drawn, {clip: d.link(clip) for clip in drawn}), kind="wide"
    )


def _contacts(d: FigureSpec) -> Figure:
    this, other = d.both(lambda n: n.movement.contact)
    feet = sorted(this, key=lambda name: (name.split("_")[-1], name.startswith("right")))  # left before right
    shares = _per_cent({name: this[name] for name in feet})
    outline = None if other is None else _per_cent(other)
    rows = tuple((name, share, *([outline.get(name)] if outline else [])) for name, share in shares.items())
    head = ("foot joint", "% of frames", *(d.other_names if outline else ()))
    body = bars({name: {"": share} for name, share in shares.items()}, "per cent of frames in contact",
                other=outline, unit=" %")  # fmt: skip
    note = "share of frames; left and right should be near each other"
    return Figure("contact", "Feet in contact", note, body, head, rows, other=d.outline)


def _per_cent(shares: Mapping[str, float | None]) -> dict[str, float]:
    return {name.replace("_", " "): round(100 * (share or 0), 1) for name, share in shares.items()}


def music_figures(d: FigureSpec) -> list[Figure]:
    """Return the figures of key motions and beats, with chance as a comparison."""
    figures = [_key_beats(d), _alignment(d), _tempos(d)]
    return [figure for figure in figures if figure is not None]


def _key_beats(d: FigureSpec) -> Figure | None:
    this, other = d.both(lambda n: n.music)
    if not this.offset_ms.n:
        return None
    note = (
        f"% of key motions; {rounded(this.mean_distance_ms)} ms from the nearest beat on average, "
        f"{rounded(this.mean_distance_shifted_ms)} ms with the beats moved by half a period "
        "(dotted: without alignment both look alike)"
    )
    edges, counts = this.offset_ms.edges, this.offset_ms.counts
    chance = this.shifted_ms.counts["all"]
    beside = None if other is None or not other.offset_ms.n else other.offset_ms.counts["all"]
    body = histogram(edges, counts, "milliseconds after the nearest beat", other=beside, chance=chance)
    columns = [counts["all"], chance, *([] if beside is None else [beside])]
    rows = tuple(zip(edges, edges[1:], *columns, strict=False))
    head = ("from", "to", "key motions", "beats moved", *(() if beside is None else d.other_names))
    return Figure("key_beats", "Key motions and beats", note, body, head, rows,
                  other="" if beside is None else d.outline, chance="beats moved by half a period")  # fmt: skip


def _alignment(d: FigureSpec) -> Figure | None:
    this, other = d.both(lambda n: n.music)
    if this.bas is None:
        return None
    scores = {"this dataset": this.bas, "chance": this.bas_chance}
    if other is not None and other.bas is not None:
        scores |= {name: other.bas for name in d.other_names}
        scores |= {f"{name}, chance": other.bas_chance for name in d.other_names}
    note = (
        f"mean over clips, beats of {this.beats_from}; "
        "a score at its chance level means that dance and beats are unrelated"
    )
    body = bars({name: {"": score or 0.0} for name, score in scores.items()}, "beat alignment score")
    return Figure("bas", "Beat alignment score", note, body, ("", "score"), tuple(scores.items()))


def _tempos(d: FigureSpec) -> Figure | None:
    this, other = d.both(lambda n: [(t.stated, t.found, t.clip) for t in n.music.tempo_bpm])
    if not this:
        return None
    off = sum(abs(measured / stated - 1) > 0.05 for stated, measured, _ in this)
    note = f"{off} of {len(this)} clips differ by more than 5 %; lines: equal, half and double"
    body = points(this, ("stated, beats per minute", "found in the beats"), other=other or ())
    rows = tuple((d.link(clip), stated, measured) for stated, measured, clip in this)
    return Figure("tempo_pairs", "Tempo, stated and found", note, body, ("clip", "stated", "found"), rows,
                  other=d.outline if other else "")  # fmt: skip


def split_figures(d: FigureSpec) -> list[Figure]:
    """Return tables of names that splits share; songs and clips that train shares are red."""
    shared, splits = d.numbers.splits, d.numbers.contents.splits
    if len(splits) < 2:
        return []
    sound = "" if shared.compared_by_sound else "; compared by name and samples, not by sound"
    songs = f"train must share none; val and test may, as in AIST++{sound}"
    figures = [_matrix(splits, "songs", "Songs that splits share", songs, shared.songs)]
    if d.numbers.totals.dancers:
        note = "no leak by itself: many datasets split by song"
        figures.append(_matrix(splits, "dancers", "Dancers that splits share", note, shared.dancers))
    note = "copies of augmentations count as their clip"
    return [*figures, _matrix(splits, "clips", "Clips that splits share", note, shared.clips)]


def _matrix(splits: Sequence[str], key: str, title: str, note: str, shared: Shared) -> Figure:
    def cell(a: str, b: str) -> Markup:
        n = shared.counts[a][b]
        if a == b:
            return Markup(f'<span class="own">{n:,}</span>')
        leak = n and key != "dancers" and "train" in (a, b)
        return Markup(f'<strong class="bad">{n:,} ⚠</strong>' if leak else f"{n:,}")

    body = table(("", *splits), [[a, *(cell(a, b) for b in splits)] for a in splits], "matrix")
    names = tuple((pair, ", ".join(shared_names)) for pair, shared_names in shared.names.items())
    return Figure(f"shared_{key}", title, note, body, ("splits", "names"), names)
