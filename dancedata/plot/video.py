"""write_video: a clip with its music as an mp4 file, for papers and user studies."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import require
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.files.atomic import require_free
from dancedata.plot.frames import THEMES, Frames, Theme
from dancedata.plot.mux import find_ffmpeg, write_mp4
from dancedata.store import Store, open_store
from dancedata.store.licence import require_shareable
from dancedata.viewer import Figure, Item, Scene, Scenes
from dancedata.viewer.source import ClipSource

__all__ = ["write_video"]

#: Smallest and largest side of the picture, pixels; H.264 needs even ones.
_SIDES = (128, 4096)


def write_video(
    store: Store | str | Path,
    clip: str,
    path: str | Path,
    *,
    source: str | Path | None = None,
    field: str | None = None,
    frame: int = 0,
    start_s: float = 0.0,
    length_s: float | None = None,
    size: tuple[int, int] = (1280, 720),
    theme: Theme = "dark",
    may_share: bool = False,
    overwrite: bool = False,
) -> Path:
    """Write a clip as a video: the dancer, and below music, speed and contacts in time.

    Parameters
    ----------
    store
        A built dataset, open or its folder.
    clip
        Id of a clip.
    path
        File to write, ``.mp4``.
    source
        Folder with the music that the dataset was built from; None: a silent video.
    field
        Motion field to draw; default: the best one.
    frame
        In window scope, the first frame of the window.
    start_s, length_s
        Part of the clip, seconds; default: all of it.
    size
        Width and height, pixels.
    theme
        "dark" or "light".
    may_share
        The caller states to have the right to pass the music on, where the dataset's licence does not allow it.
    overwrite
        Replace a file that is there.

    Returns
    -------
    Path
        The file: one picture per frame of the motion, at its rate, and the music of the same time.

    Raises
    ------
    UsageError
        If Pillow or ffmpeg is not installed, the licence does not allow the music to be passed on, there is no music
        for the clip, or an argument is invalid.
    DataError, StoreError
        If the clip or the music cannot be read, or the file cannot be written.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.write_video("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03", "dance.mp4", source="data/demo-source")
    PosixPath('dance.mp4')
    """
    target = Path(path)
    if target.suffix.lower() != ".mp4":
        raise UsageError("a video is an mp4 file", found=shown(target.name), allowed="a name that ends in .mp4")
    _require_drawable(size, theme)
    ds = store if isinstance(store, Store) else open_store(store)
    target = require_free(target, [ds.path], "video", overwrite=overwrite)
    notice = "" if source is None else require_shareable(ds, allowed_by_caller=may_share)
    scenes = Scenes(ds, field)
    item = scenes.find(clip, frame)
    scene = scenes.scene(item)
    if scene.figure is None:
        raise UsageError("no field of this dataset can be drawn", where=str(ds.path), found="; ".join(scene.notes))
    times = _times(scene, scene.figure, start_s, length_s)
    sound = None if source is None else _sound(ds, item, Path(source).expanduser(), times, scene.figure)
    frames = Frames(scene, scene.figure, size, times, theme)
    try:
        write_mp4(target, frames, size, scene.figure.grid.rate, sound, comment=notice)
    except OSError as error:
        fix = "name a file in a folder of your own, on a disk with room; nothing was left there"
        raise StoreError("the video cannot be written", where=target, found=str(error), fix=fix) from error
    return target


def _require_drawable(size: tuple[int, int], theme: str) -> None:
    low, high = _SIDES
    if not all(low <= n <= high and n % 2 == 0 for n in size):
        raise UsageError("invalid size of a video", found=f"{size}", allowed=f"even numbers from {low} to {high}")
    if theme not in THEMES:
        raise UsageError("unknown theme", found=shown(theme), allowed=" or ".join(THEMES))
    require("video", ["PIL"], what="a video")
    find_ffmpeg()


def _times(scene: Scene, figure: Figure, start_s: float, length_s: float | None) -> Float64Array:
    """Return the instants of the frames of a part of a clip."""
    rate = float(figure.grid.rate)
    finite = math.isfinite(start_s) and math.isfinite(length_s or 0.0)
    first = round(start_s * rate) if finite else -1
    last = figure.n_frames if length_s is None or not finite else min(figure.n_frames, first + round(length_s * rate))
    if not 0 <= first < last:
        raise UsageError(
            "this part of the clip has no frames",
            where=f"clip {shown(scene.item.id)}",
            found=f"from {start_s:g} s" + ("" if length_s is None else f", {length_s:g} s long"),
            allowed=f"within 0 to {figure.n_frames / rate:.2f} s",
        )
    return np.arange(first, last) / rate


def _sound(store: Store, item: Item, source: Path, times: Float64Array, figure: Figure) -> AudioSignal:
    """Return the music of the frames; silence where it ends before them."""
    found = ClipSource(store, source).sound(item)
    if found is None:
        raise UsageError("there is no music for this clip", where=source, found=f"clip {shown(item.id)}")
    music = found.signal
    first = round(float(times[0]) * music.sample_rate)
    n = round(float(figure.grid.seconds(len(times))) * music.sample_rate)
    part = music.samples[first : first + n]
    return AudioSignal(np.pad(part, (0, n - len(part))), music.sample_rate)
