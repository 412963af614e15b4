"""write_card: a README.md for a hub, and its pictures."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.execution.progress import Progress
from dancedata.plot.beat_axes import beats
from dancedata.plot.map_axes import pose_map
from dancedata.plot.motion_axes import motion
from dancedata.plot.path_axes import paths
from dancedata.publish.card_text import MARK, card_text
from dancedata.report.write import Target
from dancedata.store import Store, open_store

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

#: Dots per inch of the pictures, and the largest card, megabytes.
_DPI, _MAX_MB = 110, 5.0
#: Names that pictures of a card may have.
PICTURE_FILES = ("poses.png", "map.png", "beats.png", "paths.png")


def write_card(
    store: str | Path, to: str | Path = "README.md", *, overwrite: bool = False, progress: bool = False
) -> Path:
    """Write the card of a dataset, as ``dancedata report STORE --card`` does.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        File to write, not in the dataset; three pictures are written to the folder README_files beside it.
    overwrite
        Replace a card that this function wrote, and its pictures; other files are never replaced.
    progress
        Show progress on stderr.

    Returns
    -------
    pathlib.Path
        The file. Equal datasets give equal text; it holds no path of the machine.

    Raises
    ------
    UsageError
        If the file exists, or is another's; if the dataset has no motion to draw; where matplotlib is not installed.
    DataError, StoreError
        If the dataset is damaged, or the card cannot be written.
    """
    path = Path(to).expanduser()
    target = Target.of(path, [Path(store)], "card", max_mb=_MAX_MB, overwrite=overwrite)
    if path.exists() and MARK not in path.read_text(encoding="utf-8", errors="replace"):
        raise UsageError(
            "refusing to overwrite a file that is not a card of dancedata", where=path, fix="choose another --to"
        )
    with open_store(store) as opened:
        opened.require_intact()
        pictures = drawn_pictures(opened, Progress(quiet=not progress))
        words = {f"{quote(target.folder.name)}/{name}": what for name, (what, _) in pictures.items()}
        text = card_text(opened, words)
    target.write(text.encode(), {name: partial(bytes, picture) for name, (_, picture) in pictures.items()})
    return target.path


def drawn_pictures(store: Store, progress: Progress) -> dict[str, tuple[str, bytes]]:
    """Return the pictures of a card by file name: description, and PNG; equal datasets give equal bytes.

    UsageError if there is no motion to draw, or if matplotlib is missing.
    """
    drawn, pictures = _drawings(store), {}
    with progress.stage("drawing", len(drawn)) as advance:
        for name, (what, draw) in drawn.items():
            pictures[name] = what, _png(draw())
            advance(1)
    return pictures


def _drawings(store: Store) -> dict[str, tuple[str, Callable[[], Axes]]]:
    """Return name, description and drawing of three pictures."""
    clip = next((c.id for c in store.clips if not c.source), "")
    if not clip:
        raise UsageError("a dataset without clips has no card", where=store.path)
    third = ("beats.png", ("speed, key motions and beats of a clip", partial(beats, store, clip)))
    try:
        beats(store, clip)
    except DanceDataError:  # no music
        third = ("paths.png", ("paths of roots, from above", partial(paths, store)))
    return {
        "poses.png": ("poses of a clip", partial(motion, store, clip, poses=7)),
        "map.png": ("map of the poses along their two largest components", partial(pose_map, store)),
        third[0]: third[1],
    }


def _png(axes: Axes) -> bytes:
    data = io.BytesIO()
    axes.figure.savefig(data, format="png", dpi=_DPI, metadata={"Software": None})  # type: ignore[union-attr]
    return data.getvalue()
