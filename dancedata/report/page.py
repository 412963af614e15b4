"""The page: one HTML file without a request, in which nothing from a dataset can become markup or script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

from dancedata.core.columns import Columns
from dancedata.core.text import counted
from dancedata.report.document import Document
from dancedata.report.figures import Drawing
from dancedata.report.findings import findings
from dancedata.report.markup import Figure, escaped, number
from dancedata.report.player import NO_PLAYER, Player
from dancedata.report.sections import sections, tiles
from dancedata.viewer.payload import link

__all__ = ["PageParts", "page"]

_LABELS = {"bad": "error", "look": "look", "note": "note"}
#: Most differences that the page lists.
_DIFFERENCES = 60


@dataclass(frozen=True)
class PageParts:
    """What the page shows beside the document.

    Attributes
    ----------
    chosen
        Clips whose paths are drawn.
    columns
        Columns of each field.
    heat_maps
        The heat map of each field that has one.
    differences
        Kind and text of each difference from the other dataset.
    player
        The clips of the page.
    """

    chosen: Sequence[str]
    columns: Mapping[str, Columns]
    heat_maps: Mapping[str, Figure]
    differences: Sequence[tuple[str, str]] = ()
    player: Player = NO_PLAYER


def page(d: Drawing, parts: PageParts) -> str:
    """Return the HTML of a report."""
    found = sections(d, parts.chosen, parts.columns, parts.heat_maps)
    if d.other is not None:
        found.append(("differences", "Differences", _differences(d.other, parts.differences)))
    found.append(("about", "Source and terms", _terms(d.own)))
    links = "".join(f'<a href="#r-s-{key}">{escaped(title)}</a>' for key, title, _ in found) + _play(parts.player)
    body = "".join(f'<section><h2 id="r-s-{key}">{escaped(title)}</h2>{html}</section>' for key, title, html in found)
    own = files("dancedata.report").joinpath("static", "report.css").read_text(encoding="utf-8")
    policy = (
        f"default-src 'none'; script-src {parts.player.script_sources}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="referrer" content="no-referrer"><link rel="icon" href="data:,">'
        f"<title>{escaped(d.own['about']['name'])}: dataset report</title>"
        f'<style>{parts.player.css}{own}</style></head><body data-page="report">'
        f'<main id="r-report">{_header(d)}{tiles(d)}<nav aria-label="Sections">{links}</nav>'
        f"{_findings(d.own)}{body}</main>{parts.player.body}</body></html>\n"
    )


def _play(player: Player) -> str:
    """Return the link that opens the first clip."""
    if not player.items:
        return ""
    return f'<a class="play" href="{escaped(link(player.items[0]), 2000)}">▶ {counted(len(player.items), "clip")}</a>'


def _header(d: Drawing) -> str:
    about = d.own["about"]
    windows = about["windows"]
    other = "" if d.other is None else f" <small>against {escaped(d.other['about']['name'])}</small>"
    facts = (
        f"{about['scope']} scope, {about['fps']} frames per second, windows of {windows['length']} frames every "
        f"{windows['stride']}, skeleton {about['skeleton']['name']}"
    )
    return (
        f"<header><h1>{escaped(about['name'])}{other}</h1><p>{escaped(about['description'], 600)}</p>"
        f'<p class="sub">{escaped(facts)}</p></header>'
    )


def _findings(document: Document) -> str:
    entries = [
        f'<li class="{f.kind}"><b>{_LABELS[f.kind]}</b>'
        f'<a href="#r-{escaped(f.figure)}">{escaped(f.text, 400)}</a></li>'
        for f in findings(document)
    ]
    return f'<ul class="findings" aria-label="What stands out">{"".join(entries)}</ul>' if entries else ""


def _differences(other: Document, differences: Sequence[tuple[str, str]]) -> str:
    entries = [f"<li><b>{escaped(kind)}</b>: {escaped(text, 600)}</li>" for kind, text in differences[:_DIFFERENCES]]
    more = len(differences) - len(entries)
    if more > 0:
        entries.append(f"<li>{number(more)} more (dancedata diff)</li>")
    name = escaped(other["about"]["name"])
    what = f'<ul class="terms">{"".join(entries)}</ul>' if entries else "<p>None: the same data.</p>"
    return f"<p>This dataset first, {name} second. Outlines in the figures are those of {name}.</p>{what}"


def _terms(document: Document) -> str:
    about = document["about"]
    rows = [
        ("licence", about["licence"] or "unknown"),
        *((f"weights of {name}", text) for name, text in about["weights"].items()),
        ("cite", about["citation"] or "unknown"),
        ("dataset", about["dataset"]),
        ("recipe", about["recipe_sha256"]),
        ("made by", f"dancedata {about['dancedata']}"),
    ]
    lines = [f"<li><b>{escaped(name)}</b>: {escaped(value, 2000)}</li>" for name, value in rows]
    lines += [f"<li>{escaped(note, 2000)}</li>" for note in about["notes"]]
    if document["about"]["scope"] == "window":
        lines.append("<li>Window scope: movement was measured in windows that do not overlap.</li>")
    return f'<ul class="terms" id="r-about">{"".join(lines)}</ul>'
