"""Shared by the tests of the viewer: odd names, music of clicks, and a server."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from dancedata.synthetic import synthesise_motion
from dancedata.viewer.view import ViewRequest, serve

#: Frames per second of the dataset, its clips, and the clicks of its music: two per second.
FPS, SECONDS, RATE = 30, 6, 44_100
CLICKS = np.arange(0.25, SECONDS, 0.5)
#: Names of clips: those of files, as hostile as a file system allows.
HOSTILE = ("a\"b'c&d=e#f%41+g ?h", "<script>window.PWN=1<", "<img src=x onerror=window.PWN=1>")
#: A name that no file can have: readers of folders escape unprintable characters.
TURNED = "left\u202eright\u2028end"
FORMATS = ("wav", "flac", "ogg", "mp3")


def clicks(fmt: str, path: Path) -> None:
    """Write a song of short clicks."""
    song = np.zeros(SECONDS * RATE, np.float32)
    for at in CLICKS:
        first = round(at * RATE)
        song[first : first + 220] = 0.9 * np.sin(np.arange(220) * 0.9)
    soundfile.write(path, song, RATE, format="OGG" if fmt == "ogg" else fmt.upper())


def jumping(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Poses and translations that stand still, except for a jump to the side at every click."""
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=1)[0]
    frames = np.arange(SECONDS * FPS)
    poses = np.repeat(motion.rotations.reshape(1, 72), len(frames), axis=0)
    place = np.repeat(motion.translation, len(frames), axis=0)
    place[:, 0] += np.searchsorted(CLICKS, frames / FPS + 1e-9, side="right") % 2 * 0.3
    return poses, place


def page_data(page: Path | str) -> Any:
    """Return the data that a page of the viewer, a report or a study holds."""
    text = page if isinstance(page, str) else page.read_text(encoding="utf-8")
    return json.loads(text.partition('id="dd-data">')[2].partition("</script>")[0])


@contextmanager
def serving(request: ViewRequest) -> Iterator[str]:
    """Serve a dataset; yield the address."""
    lines: list[str] = []
    there, over = threading.Event(), threading.Event()

    def say(line: str) -> None:
        lines.append(line)
        there.set()

    errors: list[Exception] = []

    def run() -> None:
        try:
            serve(request, browser=False, say=say, until=over)
        except Exception as error:  # noqa: BLE001
            errors.append(error)
            there.set()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    there.wait(60)
    try:
        if errors:
            raise errors[0]
        yield lines[0]
    finally:
        over.set()
        thread.join(20)
