"""Checks of the HTML that was written: links and anchors lead somewhere, nothing comes from other hosts."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Elements whose address a browser follows by itself.
_LOADED = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "src", "object": "data"}
_CSS_ADDRESS = re.compile(r"(?:@import\s+|url\()\s*[\"']?((?:https?:)?//[^\"')\s]+)")


class _Page(HTMLParser):
    """The anchors, links and loaded files of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.add(given["href"])
        if address := given.get(_LOADED.get(tag, "")):
            self.loaded.add(address)


def findings(site: Path, others: frozenset[Path] = frozenset()) -> list[str]:
    """Return a line for every link that leads nowhere and for everything that is loaded from another host.

    `others` are files beside the site, such as first pages of other versions, that need not exist.
    """
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    found = [line for path, page in pages.items() for line in _of_page(site, path, page, pages, others)]
    for path in sorted(site.rglob("*.css")):
        addresses = _CSS_ADDRESS.findall(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(site)}: loads {address}" for address in addresses]
    return found


def _of_page(site: Path, path: Path, page: _Page, pages: dict[Path, _Page], others: frozenset[Path]) -> Iterator[str]:
    name = path.relative_to(site)
    for address in sorted(page.loaded):
        if urlsplit(address).netloc:
            yield f"{name}: loads {address}"
    for address in sorted(page.links | page.loaded):
        parts = urlsplit(address)
        if parts.scheme or parts.netloc:
            continue
        target = Path(os.path.normpath(path.parent / unquote(parts.path))) if parts.path else path
        if target in others:
            continue
        # Fragments with "=" are moments in the viewer, not anchors.
        if not target.is_file():
            yield f"{name}: no such file: {address}"
        elif (
            parts.fragment
            and "=" not in parts.fragment
            and target in pages
            and unquote(parts.fragment) not in pages[target].anchors
        ):
            yield f"{name}: no such anchor: {address}"
