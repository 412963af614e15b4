"""`dancedata view`: the page of a dataset, served until Ctrl-C, or of one clip, written to a file."""

from __future__ import annotations

import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from dancedata.core.errors import UsageError
from dancedata.core.system import has_display
from dancedata.core.text import shown
from dancedata.files.atomic import require_free
from dancedata.files.page_files import save_page
from dancedata.scene.motions import MotionScenes
from dancedata.scene.opus import opus
from dancedata.scene.page import PageSound, clip_page
from dancedata.scene.scene_list import Item
from dancedata.scene.scenes import Scenes
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.viewer.server import Site, ViewServer

#: How often the server looks whether it is to end.
POLL_S = 0.1


def serve(
    request: ViewRequest,
    *,
    port: int = 0,
    browser: bool = True,
    say: Callable[[str], None] = print,
    until: threading.Event | None = None,
) -> None:
    """Serve the page of a dataset on 127.0.0.1 until Ctrl-C.

    `port`: 0 for a free one.
    `browser`: Whether to open a browser, if there is a display.
    `say`: Takes lines for the user; the first one is the address.
    `until`: Ends the server when it is set; default: Ctrl-C.
    """
    mesh, opened = request.mesh(), ViewSelection.of(request)
    site = Site(opened.scenes, opened.sounds, opened.comparisons, mesh)
    end = until or _interrupt()
    with ViewServer(site, port) as server:
        # One that is not asked for plays at once; the browser keeps its sound back until the first click or key.
        address = server.address + opened.start
        say(address)
        for line in _advice(server, opened):
            say(line)
        thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), name="server", daemon=True)
        thread.start()
        # While a browser starts, the data of the first clip is loaded.
        first = (site, opened.item, request.field)
        threading.Thread(target=_warm_up, args=first, name="warm-up", daemon=True).start()
        if browser and not os.environ.get("SSH_CONNECTION") and has_display():
            webbrowser.open(address)
        end.wait()
        server.shutdown()
        thread.join()


def export_page(
    request: ViewRequest,
    to: Path,
    *,
    silent: bool = False,
    rights: str | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = print,
) -> Path:
    """Write one clip as a separate page, which works from a file, without a network."""
    if to.suffix.lower() in (".mp4", ".mov", ".webm", ".gif"):
        raise UsageError("a page is an HTML file", found=to.name, fix="write a video: --out FILE.mp4")
    if request.body_model is not None:
        raise UsageError(
            "a page that is passed on does not hold a body model: the licences of SMPL, SMPL-H and SMPL-X forbid it",
            where=request.body_model, found="--body-model with a page",
            fix="leave it out: the page draws a body of its own; or write a video of the model: --out FILE.mp4",
        )  # fmt: skip
    to = require_free(to, [request.path], "page", overwrite=overwrite)
    opened = ViewSelection.of(request)
    for line in opened.matched:
        say(f"  {line}")
    signal, notice, line = opened.music_to_pass_on(rights, silent=silent)
    sound = None if signal is None else PageSound({0: opus(signal)}, notice)
    address = opened.start if "&" in opened.start else ""  # the only item is shown without one
    page = clip_page(opened.scenes, [opened.item], sound=sound, comparisons=opened.comparisons, address=address)
    save_page(to, page)
    say(line)
    n = len(opened.scenes.items)
    if n > 1 and not request.clip:
        say(f"  it shows {shown(opened.item.name)}, one of {n}; for another, put its name after the path")
    return to


def _warm_up(site: Site, item: Item, field: str | None) -> None:
    site.answer(f"/clip/{item.number}", field, part="first")
    site.answer(f"/clip/{item.number}/music", None)


def _advice(server: ViewServer, shown: ViewSelection) -> list[str]:
    lines = [*shown.matched, *(shown.scenes.problems if isinstance(shown.scenes, MotionScenes) else ())]
    if os.environ.get("SSH_CONNECTION"):
        port, host = server.server_port, socket.gethostname()
        lines.append("On your own machine, run this line first, then open the address above there:")
        lines.append(f"  ssh -N -L {port}:127.0.0.1:{port} {host}")
    if shown.sounds is None:
        what = (
            "the folder that the dataset was built from" if isinstance(shown.scenes, Scenes) else "a song or a folder"
        )
        lines.append(f"No music: --music PATH names {what}. C clicks on the beats.")
    return [*lines, "Ctrl-C ends it."]


def _interrupt() -> threading.Event:
    """Return an event that Ctrl-C sets: it is the usual end of a server, not an interruption."""
    event = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        event.set()

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, end)
        signal.signal(signal.SIGTERM, end)
    return event
