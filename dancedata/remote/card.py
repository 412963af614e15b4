"""write_card: a README.md for a hub, and its pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote

from dancedata.core.errors import UsageError
from dancedata.files.page_files import PageFiles
from dancedata.kernel import Progress, Store, open_store
from dancedata.remote.card_text import MARK, card_text

#: Largest card, megabytes.
_MAX_MB = 5.0
#: Names that pictures of a card may have.
PICTURE_FILES = ("poses.png", "map.png", "beats.png")
#: Draws the pictures of a card, such as `dancedata.plot.card_pictures`: description and PNG by file name.
Pictures: TypeAlias = Callable[[Store, Progress], Mapping[str, tuple[str, bytes]]]


def write_card(
    store: str | Path,
    to: str | Path = "README.md",
    *,
    pictures: Pictures | None = None,
    overwrite: bool = False,
    progress: bool = False,
) -> Path:
    """Write the card of a dataset and its pictures to README_files; `overwrite` replaces what this has written."""
    path = Path(to).expanduser()
    target = PageFiles.of(path, [Path(store)], "card", max_mb=_MAX_MB, overwrite=overwrite)
    if path.exists() and MARK not in path.read_text(encoding="utf-8", errors="replace"):
        raise UsageError(
            "refusing to overwrite a file that is not a card of dancedata", where=path, fix="choose another --out"
        )
    with open_store(store) as opened:
        opened.require_intact()
        drawn = {} if pictures is None else pictures(opened, Progress(quiet=not progress))
        words = {f"{quote(target.folder.name)}/{name}": what for name, (what, _) in drawn.items()}
        text = card_text(opened, words)
    target.write(text.encode(), {name: partial(bytes, picture) for name, (_, picture) in drawn.items()})
    return target.path
