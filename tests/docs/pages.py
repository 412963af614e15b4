"""Pages of the documentation, their code, and scripts next to them."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
#: The pages of docs/ that are on the site: those that people wrote, and not the archive.
WRITTEN = sorted(
    path for path in (ROOT / "docs").rglob("*.md") if not {"archive", "api"} & set(path.relative_to(ROOT).parts)
)


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, language: str) -> list[str]:
    """Return the code of a page in a language; "" are blocks that state none."""
    return blocks_of(text_of(page), language)


def blocks_of(text: str, language: str) -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    return [code for kind, code in found if kind == language]


def with_output(page: str) -> list[tuple[str, str]]:
    """Return the Python of a page, and what it shows below each block."""
    code = r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?"
    return re.findall(code, text_of(page), flags=re.DOTALL | re.MULTILINE)


def load(path: Path) -> ModuleType:
    """Import a script that is in no package."""
    spec: Any = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look there for annotations
    spec.loader.exec_module(module)
    return module
