"""The tutorials as notebooks: python docs/site/notebooks.py FOLDER.

Text becomes cells of Markdown, blocks of Python and of the shell cells of code; equal pages give equal bytes. The
recipe that a page shows is written by its cell.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

PAGES = ("captures", "aistpp-to-a-table", "add-your-own")
_BLOCK = re.compile(r"^```(sh|python|yaml)\n(.*?)^```$\n?", re.DOTALL | re.MULTILINE)
#: What a notebook has outside of its cells.
_META = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
_MAGIC = {"sh": "%%bash\n", "python": "", "yaml": "%%writefile mine.yaml\n"}


def notebook(text: str) -> dict[str, Any]:
    """Return the notebook (format 4.5) of a page of Markdown."""
    cells: list[dict[str, Any]] = []
    end = 0
    for block in _BLOCK.finditer(text):
        _add(cells, "markdown", text[end : block.start()])
        _add(cells, "code", _MAGIC[block[1]] + block[2])
        end = block.end()
    _add(cells, "markdown", text[end:])
    return {"cells": cells, "metadata": _META, "nbformat": 4, "nbformat_minor": 5}


def _add(cells: list[dict[str, Any]], kind: str, text: str) -> None:
    source = text.strip("\n")
    if source.strip():
        code = {"execution_count": None, "outputs": []} if kind == "code" else {}
        lines = source.splitlines(keepends=True)
        cells.append({"cell_type": kind, "id": f"cell-{len(cells)}", "metadata": {}, "source": lines, **code})


def write(root: Path, folder: Path) -> list[Path]:
    """Write the notebooks of the tutorials of a checkout."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for page in PAGES:
        text = (root / "docs" / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
        path = folder / f"{page}.ipynb"
        path.write_text(json.dumps(notebook(text), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        written.append(path)
    return written


if __name__ == "__main__":
    for path in write(Path(__file__).resolve().parents[2], Path(sys.argv[1])):
        print(path)
