"""`dancedata view`: the page of a dataset, served until Ctrl-C, or of one clip, written to a file."""

from __future__ import annotations

import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

from dancedata.core.errors import StoreError, UsageError
from dancedata.files import atomic
from dancedata.files.atomic import require_free
from dancedata.store import Store, open_store
from dancedata.store.licence import require_shareable
from dancedata.viewer import Item, Scenes
from dancedata.viewer.comparisons import Comparison, OriginalComparison, comparison_of, file_format
from dancedata.viewer.page import PageSound, clip_page
from dancedata.viewer.payload import link
from dancedata.viewer.server import Site, ViewServer
from dancedata.viewer.source import ClipSource, flac


@dataclass(frozen=True)
class ViewRequest:
    """Options of `dancedata view`.

    Attributes
    ----------
    path, clip
        A dataset, and the clip or group to begin with; "" for the first. A dancer of a group is shown alone.
    field
        Motion field to draw. Default: the best one.
    source
        Folder that the dataset was built from, for its music and the original motion.
    compare
        Datasets, folders of motion files, or files.
    compare_as, normalized, scaler, clip_to_range, fps, up, unit
        How motion files are read; see `file_format`.
    at
        Seconds to begin at.
    window
        Number of the clip's window to loop; in window scope the window to show.
    """

    path: Path
    clip: str = ""
    field: str | None = None
    source: Path | None = None
    compare: Sequence[Path] = ()
    compare_as: str | None = None
    normalized: bool | None = None
    fps: str | None = None
    up: str = "y"
    unit: str = "m"
    at: float = 0.0
    window: int | None = None
    scaler: Path | None = None
    clip_to_range: bool = False

    def scenes(self) -> Scenes:
        """Open the dataset; UsageError if it has no clips."""
        scenes = Scenes(open_store(self.path), self.field)
        if not scenes.items:
            raise UsageError("this dataset has no clips to show", where=str(self.path))
        return scenes

    def comparisons(self, store: Store, source: ClipSource | None) -> tuple[Comparison, ...]:
        """Return the comparisons; equal names get a number."""
        if (self.normalized is not None or self.scaler is not None) and self.compare_as is None:
            named = "--scaler" if self.normalized is None else "--normalized"
            raise UsageError(f"{named} goes with --compare-as", fix="name the columns of the files")
        form = file_format(
            store,
            representation=self.compare_as,
            normalized=self.normalized,
            scaler=self.scaler,
            clip=self.clip_to_range,
            fps=self.fps,
            up=self.up,
            unit=self.unit,
        )
        comparisons: list[Comparison] = [] if source is None else [OriginalComparison(source=source)]
        comparisons += [comparison_of(path, store, form) for path in self.compare]
        names = [comparison.name for comparison in comparisons]
        return tuple(
            replace(comparison, name=f"{comparison.name} ({n})") if comparison.name in names[:n] else comparison
            for n, comparison in enumerate(comparisons)
        )

    def first(self, scenes: Scenes) -> tuple[Item, tuple[int, int] | None]:
        """Return the item to begin with, and the loop."""
        item = scenes.find(self.clip) if self.clip else scenes.items[0]
        if self.window is None:
            return item, None
        of_clip = scenes.items_of(item.name)
        windows = scenes.windows_of(item) if item.window is None else ()
        count = len(windows) if item.window is None else len(of_clip)
        if not 0 <= self.window < count:
            allowed = f"0 to {count - 1}" if count else "no windows"
            raise UsageError("the clip has no such window", where=item.name, found=self.window, allowed=allowed)
        if item.window is not None:
            return of_clip[self.window], None
        start, length = windows[self.window]
        return item, (start, start + length)


def serve(
    request: ViewRequest,
    *,
    port: int = 0,
    browser: bool = True,
    say: Callable[[str], None] = print,
    until: threading.Event | None = None,
) -> None:
    """Serve the page of a dataset on 127.0.0.1 until Ctrl-C.

    Parameters
    ----------
    port
        0 for a free one.
    browser
        Whether to open a browser, if there is a display.
    say
        Takes lines for the user; the first one is the address.
    until
        Ends the server when it is set; default: Ctrl-C.

    Raises
    ------
    UsageError, StoreError, SourceError
        If the dataset, the clip, the source or the port cannot be used.
    """
    scenes = request.scenes()
    source = None if request.source is None else ClipSource(scenes.store, request.source)
    item, loop = request.first(scenes)
    site = Site(scenes, source, request.comparisons(scenes.store, source))
    end = until or _interrupt()
    with ViewServer(site, port) as server:
        start = request.at or (0.0 if loop is None else float(scenes.store.grid.seconds(loop[0])))
        where = link(item, at=start, loop=loop, field=request.field or "")
        address = server.address + where
        say(address)
        for line in _advice(server, source):
            say(line)
        thread = threading.Thread(target=server.serve_forever, name="server", daemon=True)
        thread.start()
        # While a browser starts, the data of the first clip is loaded.
        threading.Thread(target=_warm_up, args=(site, item, request.field), name="warm-up", daemon=True).start()
        if browser and _has_display():
            webbrowser.open(address)
        end.wait()
        server.shutdown()
        thread.join()


def export_page(
    request: ViewRequest, to: Path, *, audio: bool = False, shared: bool = False, overwrite: bool = False
) -> Path:
    """Write one clip as a separate page, which works from a file, without a network.

    Parameters
    ----------
    audio
        Whether its music goes into the page; the licence of the dataset has to allow that.
    shared
        The caller states to have the right to pass the music on.

    Raises
    ------
    UsageError
        If the file exists or is inside the dataset, the licence does not allow the music, or the request has
        motion to compare with or a window to loop, which such a page does not show.
    StoreError
        If it cannot be written.
    """
    scenes = request.scenes()
    to = require_free(to, [request.path], "page", overwrite=overwrite)
    item, loop = request.first(scenes)
    if request.compare or loop is not None:
        extra = "motion to compare with" if request.compare else "a window to loop"
        raise UsageError(f"a page of one clip does not show {extra}", fix="leave it out, or look at the page served")
    sound = None
    if audio:
        notice = require_shareable(scenes.store, allowed_by_caller=shared)
        if request.source is None:
            raise UsageError("--audio embed needs the music", fix="name the folder with it: --source DIR")
        recording = ClipSource(scenes.store, request.source).sound(item)
        if recording is None:
            raise UsageError("the source has no music of this clip", where=request.source, found=item.name)
        sound = PageSound({0: flac(recording.signal)}, notice)
    page = clip_page(scenes, [item], sound=sound)
    try:
        atomic.write_bytes(to, page.encode())
    except OSError as error:
        raise StoreError("the page cannot be written", where=to, found=str(error)) from error
    return to


def _warm_up(site: Site, item: Item, field: str | None) -> None:
    site.answer(f"/clip/{item.number}", field, first=True)
    site.answer(f"/clip/{item.number}/music", None)


def _advice(server: ViewServer, source: ClipSource | None) -> list[str]:
    lines = []
    if os.environ.get("SSH_CONNECTION"):
        port, host = server.server_port, socket.gethostname()
        lines.append("On your own machine, run this line first, then open the address above there:")
        lines.append(f"  ssh -N -L {port}:127.0.0.1:{port} {host}")
    if source is None:
        lines.append(
            "No music: --source DIR names the folder that the dataset was built from. C clicks on the beats."
        )
    return [*lines, "Ctrl-C ends it."]


def _has_display() -> bool:
    if os.environ.get("SSH_CONNECTION"):
        return False
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _interrupt() -> threading.Event:
    """Return an event that Ctrl-C sets: it is the usual end of a server, not an interruption."""
    event = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        event.set()

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, end)
        signal.signal(signal.SIGTERM, end)
    return event
