"""The navigation of the site, from the tables of docs/README.md."""

from __future__ import annotations

import os
import re
from pathlib import Path

#: Place to add a page to the navigation: a row in the table of its group.
INDEX = Path("docs/README.md")


def groups(root: Path) -> dict[str, list[tuple[str, str]]]:
    """Return (label, page) of every group of docs/README.md; pages as paths without suffix, from the root."""
    found: dict[str, list[tuple[str, str]]] = {}
    title = ""
    for line in (root / INDEX).read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            title = line.removeprefix("## ")
        elif row := re.match(r"\| \[([^]]+)\]\(([^)#]+)\.md\) \|", line):
            page = os.path.normpath(INDEX.parent / row[2])
            found.setdefault(title, []).append((row[1], page))
    return found


def toctree(entries: list[str], caption: str = "") -> str:
    """Return a directive that puts pages into the navigation and nothing on the page."""
    options = [":hidden:", *([f":caption: {caption}"] if caption else [])]
    return "\n".join(["", "```{toctree}", *options, "", *entries, "```", ""])


def add(root: Path, page: str, text: list[str]) -> None:
    """Add to a page, as it is read, the pages below it in the navigation."""
    if page == "README":
        text[0] += toctree([f"All pages <{INDEX.with_suffix('')}>"])
        for title, pages in groups(root).items():
            entries = [f"{label} </{path}>" for label, path in pages]
            text[0] += toctree([*entries, *(["Python </docs/api/index>"] if title == "Reference" else [])], title)
