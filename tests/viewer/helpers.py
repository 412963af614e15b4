"""Shared by the tests of the viewer: odd names, music of clicks, a server, and a browser."""

import threading
from collections.abc import Callable, Iterator
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
HOSTILE = (
    "a\"b'c&d=e#f%41+g ?h",
    "<script>window.PWN=1<",
    "<img src=x onerror=window.PWN=1>",
)
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


class Browser:
    """Chromium without a display, and without any network except 127.0.0.1."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self.js: Callable[..., Any] = driver.execute_script

    def open(self, address: str) -> None:
        """Open a page and wait for its clip."""
        self.driver.get("about:blank")
        self.driver.get(address)
        self.wait("return document.querySelector('[data-dd=root]')?.dataset.ready === '1'")

    def wait(self, script: str, *arguments: Any) -> Any:
        """Wait until a script returns something true."""
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.driver, 60, poll_frequency=0.05).until(
            lambda d: d.execute_script(script, *arguments)
        )

    def later(self, script: str) -> Any:
        """Return the result of a script of promises."""
        code = (
            "const done = arguments[arguments.length - 1]; (async () => {"
            + script
            + "})().then(done, e => done('' + e))"
        )
        return self.driver.execute_async_script(code)

    def size(self, width: int, height: int) -> None:
        """Set the size of the page, CSS pixels."""
        about = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", about)

    def key(self, text: str) -> None:
        """Press a key."""
        self.driver.switch_to.active_element.send_keys(text)

    def log(self) -> list[str]:
        """Messages of the console since the last call, without Chromium's advice on reading pixels."""
        messages = [entry["message"] for entry in self.driver.get_log("browser")]
        return [m for m in messages if "willReadFrequently" not in m and "GPU stall due to ReadPixels" not in m]
