"""The figures of a report, drawn from its document and nothing else, in the order of a reader's questions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dancedata.core.text import counted
from dancedata.report.document import Document
from dancedata.report.markup import Figure, Markup, escaped, number, table
from dancedata.report.pictures import paths
from dancedata.report.svg import bars, boxes, histogram, points

#: Most bars of a chart; the table below it has all of them.
_BARS = 40
#: Paths that are drawn.
_PATHS = 12
#: Share of standing still that is worth a word.
_MUCH_STILL = 0.02


@dataclass(frozen=True)
class Drawing:
    """What figures are drawn from.

    Attributes
    ----------
    own, other
        The document, and that of the dataset it is compared with.
    links
        Clips that have a link, with its HTML.
    """

    own: Document
    other: Document | None = None
    links: Mapping[str, Markup] | None = None

    @property
    def other_name(self) -> str:
        """Name of the other dataset in legends; "" without one."""
        return "" if self.other is None else f"outline: {self.other['about']['name']}"

    def link(self, clip: str) -> Markup:
        """Return the name of a clip, as a link where the page has the clip."""
        return (self.links or {}).get(clip) or Markup(f'<span class="clip">{escaped(clip)}</span>')

    def find(self, *keys: str) -> tuple[Any, Any]:
        """Return an entry of the document and of the other one."""
        this: Any = self.own
        other: Any = self.other
        for key in keys:
            this, other = this[key], None if other is None else other[key]
        return this, other


def _histogram(
    d: Drawing, keys: Sequence[str], title: str, note: str, label: str, marks: Sequence[tuple[float, str]] = ()
) -> Figure:
    this, other = d.find(*keys)
    groups = this["counts"]
    outline = None if other is None else [sum(column) for column in zip(*other["counts"].values(), strict=True)]
    body = histogram(this["edges"], groups, label, other=outline, marks=marks)
    columns = [*groups.values(), *([outline] if outline is not None else [])]
    rows = tuple(zip(this["edges"], this["edges"][1:], *columns, strict=False))
    names = (*groups, *([d.other["about"]["name"]] if d.other is not None else []))
    legend = tuple(groups) if len(groups) > 1 else ()
    return Figure(keys[-1], title, note, body, ("from", "to", *names), rows, legend, d.other_name)


def _bars(d: Drawing, keys: Sequence[str], title: str, note: str, first: str, *, legend: bool = True) -> Figure:
    this, other = d.find(*keys)
    totals = None if other is None else {name: sum(values.values()) for name, values in other.items()}
    names = [*this, *(name for name in totals or {} if name not in this)]
    if len(names) > _BARS:
        note = f"{note}; the first {_BARS} of {len(names)}".removeprefix("; ")
    shown_rows = {name: this.get(name, {}) for name in names[:_BARS]}
    groups = tuple(next(iter(this.values()), {}))
    rows = tuple(
        (
            name,
            *(this.get(name, {}).get(g, 0) for g in groups),
            *([totals.get(name, 0)] if totals is not None else []),
        )
        for name in names
    )
    head = (first, *groups, *([d.other["about"]["name"]] if d.other is not None else []))
    body = bars(shown_rows, title, other=totals)
    return Figure(keys[-1], title, note, body, head, rows, groups if legend else (), d.other_name)


def contents_figures(d: Drawing) -> list[Figure]:
    """Return what is in the dataset."""
    contents = d.own["contents"]
    n = contents["tempo_bpm"]["n"]
    clips = d.own["totals"]["clips"]
    own_rates = (f"{rate} in {counted(count, 'clip')}" for rate, count in contents["source_rates"].items())
    rates = f"frames per second of the files: {', '.join(own_rates)}"
    alike = "; ".join(" and ".join(names) for names in contents["alike"])
    genres = f"spelt differently, probably the same: {alike}" if alike else "coloured by split"
    figures = [
        _bars(
            d,
            ("contents", "windows_by_split"),
            "Windows by split",
            "what a trainer draws from",
            "split",
            legend=False,
        ),
        _bars(d, ("contents", "windows_by_genre"), "Windows by genre", genres, "genre"),
        _bars(d, ("contents", "windows_by_song"), "Windows by song", "two colours: a song that splits share", "song"),
        _histogram(d, ("contents", "length_s"), "Length of clips", rates, "seconds"),
    ]
    if d.own["totals"]["dancers"]:
        figures.insert(2, _bars(d, ("contents", "windows_by_dancer"), "Windows by dancer", "", "dancer"))
    if n:
        tempo = _histogram(
            d, ("contents", "tempo_bpm"), "Tempo", f"{n} of {clips} clips state one", "beats per minute"
        )
        figures.append(tempo)
    gaps = contents["music_minus_motion_s"]
    if gaps["n"]:
        short = len(gaps["shorter"])
        note = f"{short} of {gaps['n']} clips have less music than motion" if short else "no clip outlasts its music"
        figures.append(
            _histogram(d, ("contents", "music_minus_motion_s"), "Music that is left after the clip", note, "seconds")
        )
    return figures


def movement_figures(d: Drawing, chosen: Sequence[str]) -> list[Figure]:
    """Return how the dancers move."""
    moves = d.own["movement"]
    if moves["field"] is None:
        return []
    speed = moves["speed_m_s"]
    marks = [(speed["p50"], f"median {number(speed['p50'])} m/s")] if speed["n"] else []
    still = moves["still"]["p50"]
    floor = moves["floor_m"]
    sliding = moves["sliding_m_s"]
    note = f"mean over {moves['joints']} joints of {moves['field']}; median {number(speed['p50'])} m/s"
    if still is not None and still >= _MUCH_STILL:
        note += f"; half of the clips stand still in more than {100 * still:.0f} % of their frames"
    figures = [
        _histogram(d, ("movement", "speed_m_s"), "Speed of the body", note, "metres per second", marks),
        _joint_speed(d),
        _histogram(
            d, ("movement", "root_extent_m"), "Floor that a clip covers",
            "larger of the two horizontal extents of the root's path", "metres",
        ),
        _paths(d, chosen),
        _histogram(d, ("movement", "turns"), "Turn of the body",
                   "largest turn of the hips within a clip", "full turns"),
        _histogram(
            d, ("movement", "floor_m"), "Height of the floor",
            f"2 % quantile of the feet's heights; {_from_to(floor['min'], floor['max'])} m", "metres",
        ),
    ]  # fmt: skip
    if moves["contact"]:
        figures.append(_contacts(d))
    if sliding["n"]:
        share = f"{100 * sliding['share_above']:.1f} % of them above {sliding['above_m_s']} m/s"
        figures.append(
            _histogram(d, ("movement", "sliding_m_s"), "Sliding in contact",
                       f"horizontal speed of feet that are labelled as standing; {share}", "metres per second",
                       [(sliding["above_m_s"], f"{sliding['above_m_s']} m/s")])
        )  # fmt: skip
    return figures


def _from_to(low: float | None, high: float | None) -> str:
    """Return both numbers, or the one that both are shown as."""
    first, last = number(low), number(high)
    return first if first == last else f"{first} to {last}"


def _joint_speed(d: Drawing) -> Figure:
    this, other = d.find("movement", "joint_speed_m_s")
    rows = [
        (name.replace("_", " "), *q.values(), *([other.get(name, {}).get("p50")] if other else []))
        for name, q in this.items()
    ]
    named = {name.replace("_", " "): q for name, q in this.items()}
    sides = {
        name: "left" if name.startswith("left") else "right" if name.startswith("right") else "mid" for name in named
    }
    head = (
        "joint",
        "p5",
        "p25",
        "p50",
        "p75",
        "p95",
        *([f"p50, {d.other['about']['name']}"] if d.other and other else []),
    )
    note = "line: 5 to 95 % of frames, box: 25 to 75 %, mark: median; blue is left, orange is right"
    beside = {name.replace("_", " "): q for name, q in (other or {}).items()}
    body = boxes(named, "metres per second", classes=sides, other=beside)
    return Figure(
        "joint_speed", "Speed by joint", note, body, head, tuple(rows), other=d.other_name if beside else ""
    )


def _paths(d: Drawing, chosen: Sequence[str]) -> Figure:
    ways = d.own["movement"]["paths_m"]
    drawn_ways = {clip: ways[clip] for clip in chosen if clip in ways} or dict(list(ways.items()))
    drawn_ways = dict(list(drawn_ways.items())[:_PATHS])
    reach = max((abs(v) for way in drawn_ways.values() for p in way for v in p), default=0.0)
    note = f"seen from above, from the filled point to the ring; each square is {number(2 * reach)} m wide"
    body = paths(drawn_ways, {clip: d.link(clip) for clip in drawn_ways})
    return Figure("paths", "Paths of the root", note, body, kind="wide")


def _contacts(d: Drawing) -> Figure:
    this, other = d.find("movement", "contact")
    named = {
        name.replace("_", " "): {"": round(100 * (share or 0), 1)} for name, share in sorted(this.items(), key=_foot)
    }
    outline = (
        None
        if other is None
        else {name.replace("_", " "): round(100 * (share or 0), 1) for name, share in other.items()}
    )
    rows = tuple((name, value[""], *([outline.get(name)] if outline else [])) for name, value in named.items())
    head = ("foot joint", "% of frames", *([d.other["about"]["name"]] if d.other and outline else []))
    return Figure("contact", "Feet in contact", "share of frames; left and right should be near each other",
                  bars(named, "per cent of frames in contact", other=outline, unit=" %"), head, rows,
                  other=d.other_name)  # fmt: skip


def _foot(item: tuple[str, Any]) -> tuple[str, bool]:
    """Order feet by joint, left before right."""
    return item[0].split("_")[-1], item[0].startswith("right")


def music_figures(d: Drawing) -> list[Figure]:
    """Return how key motions and beats lie to each other, beside chance."""
    this, other = d.find("music")
    figures = []
    hist, moved = this["offset_ms"], this["shifted_ms"]
    if hist["n"]:
        note = (
            f"{number(this['mean_distance_ms'])} ms from the nearest beat on average, "
            f"{number(this['mean_distance_shifted_ms'])} ms with the beats moved by half a period "
            "(dotted: without alignment both look alike)"
        )
        counts = moved["counts"]["all"]
        other_offsets = None if other is None or not other["offset_ms"]["n"] else other["offset_ms"]["counts"]["all"]
        label = "milliseconds after the nearest beat"
        body = histogram(hist["edges"], hist["counts"], label, other=other_offsets, chance=counts)
        columns = [hist["counts"]["all"], counts, *([] if other_offsets is None else [other_offsets])]
        rows = tuple(zip(hist["edges"], hist["edges"][1:], *columns, strict=False))
        beside = () if other_offsets is None or d.other is None else (d.other["about"]["name"],)
        figures.append(
            Figure("key_beats", "Key motions and beats", note, body,
                   ("from", "to", "key motions", "beats moved", *beside), rows,
                   other=d.other_name if beside else "", chance="beats moved by half a period")
        )  # fmt: skip
    if this["bas"] is not None:
        rows_of = {"this dataset": {"": this["bas"]}, "chance": {"": this["bas_chance"]}}
        if other is not None and other["bas"] is not None:
            name = d.other["about"]["name"] if d.other is not None else ""
            rows_of |= {name: {"": other["bas"]}, f"{name}, chance": {"": other["bas_chance"]}}
        table_rows = tuple((name, value[""]) for name, value in rows_of.items())
        note = (
            f"mean over clips, beats of {this['beats_from']}; "
            "a score at its chance level means that dance and beats are unrelated"
        )
        figures.append(
            Figure(
                "bas", "Beat alignment score", note, bars(rows_of, "beat alignment score"), ("", "score"), table_rows
            )
        )
    if this["tempo_bpm"]:
        pairs = [(t["stated"], t["found"], t["clip"]) for t in this["tempo_bpm"]]
        off = sum(abs(estimated / stated - 1) > 0.05 for stated, estimated, _ in pairs)
        note = f"{off} of {len(pairs)} clips differ by more than 5 %; lines: equal, half and double"
        other_offsets = [] if other is None else [(t["stated"], t["found"], t["clip"]) for t in other["tempo_bpm"]]
        body = points(pairs, ("stated, beats per minute", "found in the beats"), other=other_offsets)
        listed = tuple((d.link(clip), stated, estimated) for stated, estimated, clip in pairs)
        head = ("clip", "stated", "found")
        figures.append(
            Figure("tempo_pairs", "Tempo, stated and found", note, body, head, listed,
                   other=d.other_name if other_offsets else "")
        )  # fmt: skip
    return figures


def split_figures(d: Drawing) -> list[Figure]:
    """Return what splits share; red only where train is involved, and a leak."""
    shared = d.own["splits"]
    if len(d.own["contents"]["splits"]) < 2:
        return []
    sound = "" if shared["compared_by_sound"] else "; compared by name and samples, not by sound"
    notes = {
        "songs": ("Songs that splits share", f"train must share none; val and test may, as in AIST++{sound}"),
        "dancers": ("Dancers that splits share", "no leak by itself: many datasets split by song"),
        "clips": ("Clips that splits share", "copies of augmentations count as their clip"),
    }
    if not d.own["totals"]["dancers"]:
        del notes["dancers"]
    return [_matrix(d, key, *notes[key], shared[key]) for key in notes]


def _matrix(d: Drawing, key: str, title: str, note: str, shared: Mapping[str, Any]) -> Figure:
    splits = d.own["contents"]["splits"]
    rows = [[a, *(_shared_cell(key, a, b, shared["counts"][a][b]) for b in splits)] for a in splits]
    names = tuple((pair, ", ".join(songs)) for pair, songs in shared["names"].items())
    return Figure(f"shared_{key}", title, note, table(("", *splits), rows, "matrix"), ("splits", "names"), names)


def _shared_cell(key: str, a: str, b: str, n: int) -> Markup:
    if a == b:
        return Markup(f'<span class="own">{n:,}</span>')
    leak = n and key != "dancers" and "train" in (a, b)
    return Markup(f'<strong class="bad">{n:,} ⚠</strong>' if leak else f"{n:,}")
