"""The reference: one page for each module that docs/python.md lists, from the docstrings."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

#: The list of modules, in the first column of a table.
LIST = Path("docs/python.md")
#: Output folder of the pages; git ignores it.
PAGES = Path("docs/api")


def modules(root: Path) -> list[str]:
    """Return the modules in the table of docs/python.md."""
    text = (root / LIST).read_text(encoding="utf-8")
    return re.findall(r"^\| `(dancedata[a-z0-9_.]*)` \|", text, flags=re.MULTILINE)


def elsewhere(name: str, listed: list[str]) -> dict[str, str]:
    """Return the public names of a module that are defined in another listed one, and its name."""
    module = importlib.import_module(name)
    values = {public: getattr(module, public) for public in getattr(module, "__all__", ())}
    homes = {public: getattr(value, "__module__", name) for public, value in values.items()}
    return {public: home for public, home in homes.items() if home != name and home in listed}


def _head(name: str) -> str:
    return f"{name}\n{'=' * len(name)}\n\n.. automodule:: {name}"


def page(name: str, listed: list[str]) -> str:
    """Return the page of a module. A name has one entry, in the module that defines it."""
    others = elsewhere(name, listed)
    lines = [_head(name)]
    lines += [f"   :exclude-members: {', '.join(others)}"] if others else []
    lines += ["", *([".. rubric:: Names from other modules", ""] if others else [])]
    lines += [f"- :py:obj:`{public} <{home}.{public}>`" for public, home in others.items()]
    return "\n".join([*lines, ""])


def write_pages(root: Path) -> None:
    """Write the page of every module, where it changed, and remove those of modules that are no longer listed."""
    (root / PAGES).mkdir(exist_ok=True)
    listed = modules(root)
    pages = {root / PAGES / f"{name}.rst": page(name, listed) for name in listed}
    for path in set((root / PAGES).glob("*.rst")) - pages.keys():
        if path.read_text(encoding="utf-8").startswith(_head(path.stem)):  # else others wrote it
            path.unlink()
    for path, text in pages.items():
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
