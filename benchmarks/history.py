"""The measurements as data, benchmarks/history.json, and their page, benchmarks/history.md.

    python benchmarks/history.py              # writes the page from the data
    python benchmarks/history.py --from-page  # takes what was written into the page over into the data

A section of the data has the `title`, the `commands` that measured it, `dates`, `processors` and `versions` as its
text states them, and its `blocks` in order: `text` (lines), or a table with `columns` and `rows`. `numbers(cell)`
returns the numbers of a cell such as "5.2, 5.0".
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_suffix(".md")
DATA = Path(__file__).with_suffix(".json")
_PACKAGES = "Python|numpy|scipy|librosa|numba|soxr|torch|transformers|h5py|webdataset|litdata|zarr|typer"
_RULE = re.compile(r"\|(?:---\|)+")


def numbers(cell: str) -> list[float]:
    """Return the numbers in a cell, without thousands separators."""
    return [float(n.replace(",", "")) for n in re.findall(r"-?\d+(?:,\d{3})*(?:\.\d+)?(?:e-?\d+)?", cell)]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line[1:-1].split("|")]


def _row(cells: list[str]) -> str:
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def read_page(page: str) -> list[dict[str, Any]]:
    """Return the sections of a page; the first is what stands above the first heading of level 2."""
    sections = []
    for part in re.split(r"^(?=## )", page, flags=re.MULTILINE):
        title, _, body = part.partition("\n")
        blocks: list[dict[str, Any]] = []
        for block in body.strip("\n").split("\n\n"):
            lines = block.split("\n")
            if len(lines) > 1 and _RULE.fullmatch(lines[1]):
                blocks.append({"columns": _cells(lines[0]), "rows": [_cells(line) for line in lines[2:]]})
            else:
                blocks.append({"text": lines})
        text = " ".join(" ".join(block.get("text", ())) for block in blocks)
        sections.append(
            {
                "title": title.lstrip("# "),
                "commands": sorted(set(re.findall(r"`(python benchmarks/[^`]+)`", text))),
                "dates": sorted(set(re.findall(r"\b20\d\d-\d\d-\d\d\b", text))),
                "processors": sorted(set(re.findall(r"AMD EPYC|Intel Xeon|Xeon at 2.5 GHz|H100|H200", text))),
                "versions": dict(re.findall(rf"\b({_PACKAGES}) (\d[\d.]*\d)", text)),
                "blocks": blocks,
            }
        )
    return sections


def page_of(sections: list[dict[str, Any]]) -> str:
    """Return the page of sections."""
    parts = []
    for number, section in enumerate(sections):
        blocks = [f"{'##' if number else '#'} {section['title']}"]
        for block in section["blocks"]:
            if "text" in block:
                blocks.append("\n".join(block["text"]))
            else:
                rule = "|" + "---|" * len(block["columns"])
                blocks.append("\n".join([_row(block["columns"]), rule, *map(_row, block["rows"])]))
        parts.append("\n\n".join(blocks))
    return "\n\n".join(parts) + "\n"


def data_of(sections: list[dict[str, Any]]) -> str:
    """Return sections as JSON, with a line for each row of a table."""
    text = json.dumps(sections, indent=1, ensure_ascii=False)
    rows = re.compile(r"\[\s+((?:\"(?:[^\"\\]|\\.)*\",?\s+)+)\]")
    return rows.sub(lambda m: "[" + re.sub(r'(?<=",)\s+', " ", m[1]).strip() + "]", text) + "\n"


if __name__ == "__main__":
    if sys.argv[1:] == ["--from-page"]:
        DATA.write_text(data_of(read_page(PAGE.read_text(encoding="utf-8"))), encoding="utf-8")
    elif not sys.argv[1:]:
        PAGE.write_text(page_of(json.loads(DATA.read_text(encoding="utf-8"))), encoding="utf-8")
    else:
        sys.exit(__doc__)
