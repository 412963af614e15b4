"""The page: one HTML file without a request, in which nothing from a dataset can become markup or script."""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import takewhile

from dancedata.core.columns import Columns
from dancedata.core.quality import REPAIRED
from dancedata.core.text import counted, listed
from dancedata.pages.column_figures import column_figures
from dancedata.pages.document import Document
from dancedata.pages.figures import FigureSpec, contents_figures, movement_figures, music_figures, split_figures
from dancedata.pages.findings import findings
from dancedata.pages.group_figures import group_figures
from dancedata.pages.markup import Figure, Markup, escaped, number, percent, rounded, scrolled
from dancedata.pages.outliers import LIMIT, MEASURES, Outlier
from dancedata.pages.player import NO_PLAYER, Player
from dancedata.pages.rhythm_figures import rhythm_figures
from dancedata.pages.space_figures import pose_figures, split_space_figures
from dancedata.pages.stage_figures import stage_figures
from dancedata.pages.svg import bars
from dancedata.scene.page import source_hash
from dancedata.scene.payload import link

#: Rows of the list of clips to look at, and names of clips that were left out for a reason.
_LOOK, _NAMED = 20, 12
#: Bars of a chart of flags.
_FLAGS = 24
#: Reasons of the ranking, as shown.
_WHY = {"flags": "flags per second", "sliding": "sliding feet", "still": "standing still"}

Section = tuple[str, str, str]


def sections(
    d: FigureSpec, chosen: Sequence[str], columns: Mapping[str, Columns], heat_maps: Mapping[str, Figure]
) -> list[Section]:
    """Return (id, title, HTML) of the sections, without those that are empty; `chosen` are clips with drawn paths."""
    parts = [
        ("look", "Look at these first", _look(d)),
        ("contents", "What is in it", grid(contents_figures(d))),
        ("movement", "How it moves",
         grid([*movement_figures(d, chosen), *stage_figures(d), *pose_figures(d), *outlier_figures(d)])),
        ("groups", "Dancers together", grid(group_figures(d))),
        ("music", "Music and dance", grid([*music_figures(d), *rhythm_figures(d)])),
        ("segments", "Words and events", grid(_segments(d))),
        ("splits", "Splits", grid([*split_figures(d), *split_space_figures(d)])),
        ("columns", "Columns", grid(column_figures(d, columns, heat_maps))),
        ("left-out", "Left out and flagged", grid(_left_out(d))),
    ]  # fmt: skip
    return [part for part in parts if part[2]]


def grid(figures: Sequence[Figure]) -> str:
    """Return figures in the columns of the page, with small holes: wide ones before the first narrow one, or last."""
    first = list(takewhile(lambda figure: figure.kind == "wide", figures))
    narrow = [figure for figure in figures if figure.kind != "wide"]
    last = [figure for figure in figures[len(first) :] if figure.kind == "wide"]
    html = "".join(figure.to_html() for figure in (*first, *packed(narrow), *last))
    return f'<div class="grid">{html}</div>' if html else ""


def packed(figures: Sequence[Figure]) -> list[Figure]:
    """Return figures in an order in which columns that are filled one after the other end at about one height.

    The highest first, each goes to the column that is lowest so far (longest processing time first: Graham, 1969);
    columns, and the figures of each, stay in their order.
    """
    columns: list[list[int]] = [[] for _ in range(_COLUMNS)]
    high = [0.0] * _COLUMNS
    heights = [figure.height for figure in figures]
    for k in sorted(range(len(figures)), key=lambda k: (-heights[k], k)):
        lowest = high.index(min(high))
        columns[lowest].append(k)
        high[lowest] += heights[k]
    return [figures[k] for column in sorted(map(sorted, columns)) for k in column]


def _look(d: FigureSpec) -> str:
    ranking = d.numbers.ranking[:_LOOK]
    if not ranking:
        return ""
    clips = {row.clip: row for row in d.numbers.clips}
    rows = []
    for suspect in ranking:
        clip = clips[suspect.clip]
        n = clip.numbers
        rows.append((d.link(clip.clip), Markup(_WHY[suspect.why]), clip.split, clip.flags, percent(n.sliding),
                     percent(n.still), n.speed, n.seconds))  # fmt: skip
    head = ("clip", "because of", "split", "flags", "sliding", "still", "speed m/s", "seconds")
    left = len(d.numbers.ranking) - len(ranking)
    more = f"; {left:,} more in the numbers (--json)" if left > 0 else ""
    note = f"most flags per second, most sliding in contact, longest standing still take turns{more}"
    return Figure("look", "Clips in the order of suspicion", note, scrolled(head, rows), kind="wide").to_html()


def outlier_figures(d: FigureSpec, among: str = "all clips") -> list[Figure]:
    """Return the table of clips whose movement is unlike that of the others; `among` names those."""
    outliers = d.numbers.outliers
    if not outliers:
        return []
    rows = [(d.link(outlier.clip), Markup("<br>".join(_reasons(outlier)))) for outlier in outliers[:_LOOK]]
    left = len(outliers) - len(rows)
    note = f"robust z above {LIMIT:g}: a number far above the median of {among}" + (f"; {left:,} more" * (left > 0))
    body = scrolled(("clip", "because of"), rows, "list texts")
    return [Figure("outliers", "Clips unlike the others", note, body, kind="wide")]


def _reasons(outlier: Outlier) -> list[str]:
    texts = []
    for reason in outlier.reasons:
        name, unit = MEASURES[reason.measure]
        values = f"{rounded(reason.value)} {unit}".strip(), f"{rounded(reason.median)} {unit}".strip()
        texts.append(f"{name}: {escaped(values[0])}, median {escaped(values[1])} ({_z(reason.z)})")
    return texts


def _z(value: float) -> str:
    """Return a robust z as text: among numbers that are nearly equal, any other has one of thousands."""
    return f"z {rounded(value)}" if abs(value) <= _MOST_Z else f"z above {_MOST_Z}"


def _left_out(d: FigureSpec) -> list[Figure]:
    figures = []
    if d.numbers.left_out:
        rows = [
            (reason, entry.n, _text(listed(entry.names, _NAMED), 2000), _text(entry.detail, 300))
            for reason, entry in d.numbers.left_out.items()
        ]
        head = ("reason", "number", "names", "message of the first")
        body = scrolled(head, rows, "list texts")
        figures.append(Figure("left_out", "Left out, by reason", "all names are in rejects.jsonl", body, kind="wide"))
    by_kind = _flags(d, "flags", "Flags by kind", lambda n: n.flags.by_kind)
    by_joint = _flags(d, "flags_joint", "Flags by joint", lambda n: n.flags.by_joint)
    return [*figures, *by_kind, *by_joint]


def _segments(d: FigureSpec) -> list[Figure]:
    """Return the table of the layers of segments, without the quality flags, which are shown by themselves."""
    layers = [layer for layer in d.numbers.segments if layer.name != "quality"]
    if not layers:
        return []
    head = ("layer", "language", "author", "segments", "clips", "median s", "coverage", "texts", "words per text",
            "left and right", "labels")  # fmt: skip
    rows = [
        (
            layer.name, layer.language, layer.author, layer.segments, layer.clips, layer.median_s,
            percent(layer.coverage), layer.texts, layer.words / layer.texts if layer.texts else None, layer.sided,
            _text(listed(f"{label} {n}" for label, n in layer.labels.items()), 300),
        )
        for layer in layers
    ]  # fmt: skip
    body = scrolled(head, rows, "list texts")
    note = "of clips that are not copies; coverage is the share of frames in a segment"
    return [Figure("segments", "Layers of segments", note, body, kind="wide")]


def _text(text: str, limit: int) -> Markup:
    return Markup(f'<div class="text">{escaped(text, limit)}</div>')


def _flags(d: FigureSpec, key: str, title: str, part: Callable[[Document], Mapping[str, int]]) -> list[Figure]:
    this, other = d.both(part)
    names = [*this, *(name for name in other or {} if name not in this)]
    if not names:
        return []
    counts = {name.replace("_", " "): this.get(name, 0) for name in names}
    beside = None if other is None else {name.replace("_", " "): n for name, n in other.items()}
    rows = tuple((name, n, *([] if beside is None else [beside.get(name, 0)])) for name, n in counts.items())
    shown_rows = {name: {"": n} for name, n in list(counts.items())[:_FLAGS]}
    body = bars(shown_rows, title, other=beside)
    repaired = any(kind in REPAIRED for kind in d.numbers.flags.by_kind)
    note = "marked; frames of the kinds repaired were changed" if repaired else "marked, not repaired"
    return [Figure(key, title, note, body, ("", "flags", *d.other_names), rows, other=d.outline)]


def tiles(d: FigureSpec) -> str:
    """Return the numbers at the top of the page."""
    names = {"clips": "clips", "groups": "groups", "copies": "copies", "windows": "windows", "minutes": "minutes",
             "songs": "songs", "dancers": "dancers", "genres": "genres", "left_out": "left out",
             "flagged_clips": "flagged clips"}  # fmt: skip
    totals, beside_totals = vars(d.numbers.totals), {} if d.other is None else vars(d.other.totals)
    cells = ""
    for key, name in names.items():
        this, other = totals[key], beside_totals.get(key)
        if key in ("groups", "copies", "dancers", "genres") and not this and not other:
            continue
        show = "{:.1f}".format if key == "minutes" else number
        beside = "" if other is None else f" ({show(other)})"
        cells += f"<div><dt>{name}</dt><dd>{show(this)}<small>{beside}</small></dd></div>"
    return f'<dl class="tiles">{cells}</dl>'


#: Largest z that is printed.
_MOST_Z = 100
#: Columns of figures in a window of usual width.
_COLUMNS = 3
_LABELS = {"good": "good", "bad": "error", "look": "look", "note": "note"}
#: Most differences that the page lists.
_DIFFERENCES = 60


def page(
    d: FigureSpec,
    chosen: Sequence[str],
    columns: Mapping[str, Columns],
    heat_maps: Mapping[str, Figure],
    stills: Sequence[tuple[str, str]] = (),
    differences: Sequence[tuple[str, str]] | None = None,
    player: Player = NO_PLAYER,
) -> str:
    """Return the HTML of a report."""
    chapters = sections(d, chosen, columns, heat_maps)
    if d.other is not None:
        chapters.append(("differences", "Differences", _differences(d.other, differences)))
    if d.numbers.columns:
        lines = "".join(f"<li>{escaped(str(column), 2000)}</li>" for column in d.numbers.columns)
        chapters.append(("columns", "Columns of the clips", f'<ul class="terms">{lines}</ul>'))
    chapters.append(("about", "Source and terms", _terms(d.numbers)))
    links = chapter_links(chapters, player)
    body = chapters_html(chapters)
    main = (
        f"{_header(d)}{tiles(d)}{_stills(d, stills)}"
        f'<nav aria-label="Sections">{links}</nav>'
        f"{_findings(d.numbers)}{body}"
    )
    return whole_page(f"{d.numbers.about.name}: dataset report", main, player)


def chapters_html(chapters: Sequence[Section]) -> str:
    """Return the HTML of sections."""
    return "".join(
        f'<section><h2 id="r-s-{key}">{escaped(title)}</h2>{html}</section>' for key, title, html in chapters
    )


def whole_page(title: str, main: str, player: Player) -> str:
    """Return the HTML of a page with a player; `main` is HTML."""
    style = files("dancedata.pages").joinpath("static", "report.css").read_text(encoding="utf-8")
    sort = files("dancedata.pages").joinpath("static", "tables.js").read_text(encoding="utf-8")
    sources = f"'{source_hash(sort)}' {player.script_sources}".removesuffix(" 'none'")
    policy = (
        f"default-src 'none'; script-src {sources}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="referrer" content="no-referrer"><link rel="icon" href="data:,">'
        f"<title>{escaped(title)}</title>"
        f'<style>{player.css}{style}</style></head><body data-page="report">'
        f'<main id="r-report">{main}</main>{player.body}<script>{sort}</script></body></html>\n'
    )


def chapter_links(chapters: Sequence[Section], player: Player, item: str = "clip") -> str:
    """Return the links to the sections, and the one that opens the first clip or group."""
    links = "".join(f'<a href="#r-s-{key}">{escaped(title)}</a>' for key, title, _ in chapters)
    if not player.items:
        return links
    kind = "group" if all(shown.members for shown in player.items) else item
    address, clips = escaped(link(player.items[0]), 2000), counted(len(player.items), kind)
    return f'{links}<a class="play" href="{address}">▶ {clips}</a>'


def _stills(d: FigureSpec, stills: Sequence[tuple[str, str]]) -> str:
    cells = "".join(f"<li>{image}{d.link(clip)}</li>" for clip, image in stills)
    return f'<ul class="stills" aria-label="Clips">{cells}</ul>' if cells else ""


def _header(d: FigureSpec) -> str:
    about = d.numbers.about
    other = "" if d.other is None else f" <small>against {escaped(d.other.about.name)}</small>"
    facts = (
        f"{about.fps} frames per second, windows of {about.windows['length']} frames every "
        f"{about.windows['stride']}, skeleton {about.skeleton['name']}"
    )
    return (
        f"<header><h1>{escaped(about.name)}{other}</h1><p>{escaped(about.description, 600)}</p>"
        f'<p class="sub">{escaped(facts)}</p></header>'
    )


def _findings(document: Document) -> str:
    entries = [
        f'<li class="{f.kind}"><b>{_LABELS[f.kind]}</b>'
        f'<a href="#r-{escaped(f.figure)}">{escaped(f.text, 400)}</a></li>'
        for f in findings(document)
    ]
    return f'<ul class="findings" aria-label="What stands out">{"".join(entries)}</ul>' if entries else ""


def _differences(other: Document, differences: Sequence[tuple[str, str]] | None) -> str:
    name = escaped(other.about.name)
    head = f"<p>This dataset first, {name} second. Outlines in the figures are those of {name}.</p>"
    if differences is None:
        return head
    entries = [f"<li><b>{escaped(kind)}</b>: {escaped(text, 600)}</li>" for kind, text in differences[:_DIFFERENCES]]
    more = len(differences) - len(entries)
    if more > 0:
        entries.append(f"<li>{number(more)} more (dancedata check --same-as)</li>")
    what = f'<ul class="terms">{"".join(entries)}</ul>' if entries else "<p>None: the same data.</p>"
    return head + what


def _terms(document: Document) -> str:
    about = document.about
    rows = [
        ("licence", about.licence or "unknown"),
        *(("licence of", text) for text in about.licences),
        *((f"weights of {name}", text) for name, text in about.weights.items()),
        ("cite", about.citation or "unknown"),
        ("dataset", about.dataset),
        ("recipe", about.recipe_sha256),
        ("made by", f"dancedata {about.dancedata}"),
    ]
    lines = [f"<li><b>{escaped(name)}</b>: {escaped(value, 2000)}</li>" for name, value in rows]
    lines += [f"<li>{escaped(note, 2000)}</li>" for note in about.notes]
    if any(row.slice_of for row in document.clips):
        lines.append("<li>Movement was measured in slices that do not overlap.</li>")
    return f'<ul class="terms" id="r-about">{"".join(lines)}</ul>'
