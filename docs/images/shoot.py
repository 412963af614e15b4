"""Takes the pictures of the viewer, of studies and of reports: python docs/images/shoot.py SHARED [NAME ...].

Without names, those that the pages show, as NAME.png in light and NAME-dark.png in dark, of which the site shows the
one of its theme; with `all`, or the name of one that no page shows, into ./pictures. SHARED
is the folder with the real recordings, which are not part of the project (`realdata`); the demo is built. It needs
chromium and chromedriver, selenium and Pillow (`pip install -e ".[dev]"`). Pictures differ by the fonts of the
machine, so tests do not compare them. PNGs get a palette of 256 colours.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from PIL import Image
from scipy.ndimage import uniform_filter1d

import dancedata
from dancedata.core.registry import DATASETS
from dancedata.pages import write_report
from dancedata.pages.samples import write_samples_report
from dancedata.study.page import StudyRequest, write_study
from dancedata.viewer.view import ViewRequest, serve

HERE = Path(__file__).resolve().parent
#: Songs that may be passed on, in place of those of AIST++, which may not.
SONGS = {
    "mBR2": "Kevin_MacLeod_-_Vibe_Ace",
    "mJS2": "Kevin_MacLeod_-_Vibe_Ace",
    "mJS4": "Karissa_Hobbs_-_Lets_Go_Fishin",
}
LONG, FLAGGED = "gJS_sFM_cAll_d02_mJS4_ch09", "gBR_sBM_cAll_d04_mBR2_ch08"
READY = "const r = document.querySelector('[data-dd=root]'), s = window.dancedataViewer && dancedataViewer.state;"
READY += "const f = s && s.clip && (s.clip.figure || s.clip.members[0].figure);"
READY += "return r && r.dataset.ready === '1' && f && !s.dirty && (!arguments[0] || !!s.clip.wave)"
READY += "&& (s.body < 2 || f.turning)"


@dataclass(frozen=True)
class Data:
    """The datasets of the pictures, with their sources."""

    real: Path
    real_source: Path
    demo: Path
    demo_source: Path
    duets: Path
    shared: Path


def build(shared: Path, folder: Path) -> Data:
    """Build the real clips with the songs that may be shown, and the demo."""
    source, real = folder / "aist_plusplus_final", shared / "realdata"
    for name in ("motions", "splits", "cameras"):
        shutil.copytree(real / "aistpp" / name, source / name)
    (source / "wavs").mkdir()
    for song, title in SONGS.items():
        samples, rate = soundfile.read(real / "music" / f"{title}.hq.ogg", frames=40 * 44100)
        soundfile.write(source / "wavs" / f"{song}.wav", samples, rate, subtype="PCM_16")
    cache = folder / "cache"
    dancedata.build("aist++", source, folder / "aist++", jobs=1, cache=cache, progress=False)
    dancedata.build("demo", out=folder / "demo", jobs=1, cache=cache, progress=False)
    DATASETS.get("dd100")().make_example(folder / "dd100-source")
    dancedata.build("dd100", folder / "dd100-source", folder / "dd100", jobs=1, cache=cache, progress=False)
    return Data(folder / "aist++", source, folder / "demo", folder / "demo-source", folder / "dd100", real)


class Camera:
    """Chromium without a display."""

    def __init__(self) -> None:
        os.environ["SE_OFFLINE"] = "true"
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        flags = [
            "headless",
            "enable-unsafe-swiftshader",
            "hide-scrollbars",
            "no-first-run",
            "force-color-profile=srgb",
        ]
        for flag in [*flags, *(["no-sandbox"] if os.geteuid() == 0 else [])]:
            options.add_argument(f"--{flag}")
        self.driver = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))

    def size(self, width: int, height: int, scale: float = 1) -> None:
        """Set the size of the page, CSS pixels."""
        about = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", about)

    def theme(self, name: str) -> None:
        """Set the system's theme."""
        features = [{"name": "prefers-color-scheme", "value": name}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def open(self, address: str, script: str, *arguments: Any) -> None:
        """Open a page and wait until a script returns something true."""
        from selenium.webdriver.support.ui import WebDriverWait

        self.driver.get("about:blank")
        self.driver.get(address)
        WebDriverWait(self.driver, 60, poll_frequency=0.05).until(lambda d: d.execute_script(script, *arguments))

    def picture(self) -> Image.Image:
        """Return what is shown."""
        return Image.open(io.BytesIO(self.driver.get_screenshot_as_png())).convert("RGB")


@contextmanager
def served(request: ViewRequest) -> Iterator[str]:
    """Serve a dataset; gives the address with the secret."""
    lines: list[str] = []
    there, over = threading.Event(), threading.Event()

    def say(line: str) -> None:
        lines.append(line)
        there.set()

    thread = threading.Thread(target=serve, args=(request,), kwargs={"browser": False, "say": say, "until": over})
    thread.start()
    try:
        there.wait(60)
        yield lines[0].partition("#")[0]
    finally:
        over.set()
        thread.join()


def smoothed(data: Data, clip: str, frames: int = 15) -> Path:
    """Write a clip's joints, each averaged over some frames, as a model may give them."""
    with dancedata.open(data.real) as store:
        joints = dancedata.decode(store[clip].read("edge151"), "edge151", fps=store.fps).joints()
    folder = data.real.parent / ("smoothed" if frames == 15 else f"over-{frames}")
    folder.mkdir(exist_ok=True)
    np.save(folder / f"{clip}.npy", uniform_filter1d(joints, frames, axis=0, mode="nearest"))
    return folder


def viewer(
    camera: Camera, data: Data, theme: str, clip: str, more: str = "", *, size: tuple[int, int] = (1280, 800)
) -> Image.Image:
    """Return a picture of a real clip in the viewer."""
    camera.size(*size)
    camera.theme(theme)
    compare = (smoothed(data, clip),) if "with=smoothed" in more else ()
    with served(ViewRequest(data.real, music=data.real_source, compare=compare)) as address:
        camera.open(f"{address}#clip={clip}&theme={theme}{more}", READY, True)
        camera.driver.execute_script("document.activeElement.blur()")
        return camera.picture()


def duet(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return a picture of a generated duet in the viewer."""
    camera.size(1280, 800)
    camera.theme(theme)
    with served(ViewRequest(data.duets, music=data.duets.with_name("dd100-source"))) as address:
        camera.open(f"{address}#group=Waltz_5_0&theme={theme}&t=6.90", READY, True)
        camera.driver.execute_script("document.activeElement.blur()")
        return camera.picture()


def motion(camera: Camera, theme: str, path: Path, more: str, **options: Any) -> Image.Image:
    """Return a picture of a file of motion in the viewer, near by."""
    camera.size(1280, 800)
    with served(ViewRequest(path, **options)) as address:
        camera.open(f"{address}#theme={theme}{more}", READY, False)
        camera.driver.execute_script("dancedataViewer.camera.zoom = 0.75; dancedataViewer.state.dirty = true")
        camera.driver.execute_script("document.activeElement.blur()")
        return camera.picture()


def wall(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return a picture of the dancers of a song of the demo on one stage."""
    camera.size(1280, 720)
    with served(ViewRequest(data.demo, music=data.demo_source, wall=True)) as address:
        camera.open(f"{address}#group=mBR0&theme={theme}&t=3.20&body=2", READY, True)
        camera.driver.execute_script("document.activeElement.blur()")
        return camera.picture()


def wall_of_twelve(camera: Camera, data: Data, theme: str, size: tuple[int, int]) -> Image.Image:
    """Return a picture of a real clip beside eleven copies of it, smoothed more and more."""
    camera.size(*size)
    compare = tuple(smoothed(data, LONG, 5 + 6 * k) for k in range(11))
    request = ViewRequest(data.real, LONG, music=data.real_source, compare=compare, wall=True)
    with served(request) as address:
        camera.open(f"{address}#group={LONG}&theme={theme}&t=21.30", READY, True)
        camera.driver.execute_script("document.activeElement.blur()")
        return camera.picture()


def study(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return a picture of a study of the real clips and their smoothed joints, while a pair dances."""
    page = data.demo.parent / "study.html"
    smoothed(data, FLAGGED)
    folder = smoothed(data, LONG)
    systems = {"truth": ViewRequest(data.real, music=data.real_source), "smoothed": ViewRequest(folder, fps="30")}
    write_study(StudyRequest(systems, songs=2, checks=0), page, rights="the demo's own", overwrite=True)
    camera.size(1280, 800)
    camera.theme(theme)
    camera.open(page.as_uri(), "return document.readyState === 'complete'")
    camera.driver.execute_script(
        "document.querySelector('[data-st=who]').value = 'r1'; document.querySelector('[data-st=begin]').click()"
    )
    time.sleep(3)
    return camera.picture()


def grey(picture: Image.Image) -> Image.Image:
    """Return a picture without colours, as printed."""
    return picture.convert("L").convert("RGB")


def opened(camera: Camera, page: Path, theme: str, size: tuple[int, int], scroll: str = "") -> Image.Image:
    """Return a picture of a report, from its top or from a section on."""
    camera.size(*size)
    camera.theme(theme)
    camera.open(page.as_uri(), "return document.readyState === 'complete'")
    if scroll:
        camera.driver.execute_script("document.getElementById(arguments[0]).scrollIntoView()", scroll)
    return camera.picture()


def report(camera: Camera, data: Data, theme: str, scroll: str = "", height: int = 900) -> Image.Image:
    """Return a picture of the demo's report."""
    page = data.demo.parent / "demo-report.html"
    if not page.exists():
        write_report(data.demo, page)
    return opened(camera, page, theme, (1280, height), scroll)


def poses(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return the map of poses of the demo's report, with the pointer on a hexagon far from the middle."""
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    report(camera, data, theme, "r-poses", 620)
    cells = camera.driver.find_elements(By.CSS_SELECTOR, ".posemap .hex")
    ActionChains(camera.driver).move_to_element(cells[len(cells) // 9]).perform()
    return camera.picture()


def against(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return figures of the report of the real clips against the demo."""
    page = data.demo.parent / "against.html"
    if not page.exists():
        write_report(data.real, page, against=data.demo)
    return opened(camera, page, theme, (1280, 900), "r-s-movement")


def real(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return the top of the report of the real clips."""
    page = data.demo.parent / "real.html"
    if not page.exists():
        write_report(data.real, page)
    return opened(camera, page, theme, (1280, 900))


def samples(camera: Camera, data: Data, theme: str, size: tuple[int, int] = (1280, 900)) -> Image.Image:
    """Return the top of the report of samples: clips of the demo, smoothed, one with a root that rises."""
    page, folder = data.demo.parent / "samples.html", data.demo.parent / "samples"
    if not page.exists():
        folder.mkdir()
        with dancedata.open(data.demo) as store:
            for number, clip in enumerate(store.clips("test")[:6]):
                columns = uniform_filter1d(clip.read("edge151"), 3 + 4 * number, axis=0, mode="nearest")
                if number == 1:
                    columns[:, 6] += np.linspace(0, 1, len(columns))
                np.save(folder / f"{clip.id}.npy", columns)
        write_samples_report(dancedata.evaluate(folder, like=data.demo, normalized=False), data.demo, page)
    return opened(camera, page, theme, size)


def terminal(camera: Camera, data: Data, theme: str) -> Image.Image:
    """Return what commands print on a terminal of 80 columns, as rich draws its colours."""
    from rich.console import Console
    from rich.terminal_theme import DEFAULT_TERMINAL_THEME, MONOKAI
    from rich.text import Text

    folder = data.demo.parent
    console = Console(record=True, width=80, file=io.StringIO(), force_terminal=True)
    commands = (
        ["--help"], ["build", "demo", "--out", str(folder / "again"), "--jobs", "1"], ["info", str(data.demo)],
        ["view", str(data.demo), "nosuchclip"], ["check", str(data.demo_source)],
    )  # fmt: skip
    for command in commands:
        console.print(f"$ dancedata {' '.join(command)}".replace(f"{folder}/", ""), markup=False, highlight=False)
        console.print(Text.from_ansi(typed(command, folder)))
    page = folder / "terminal.html"
    colours = MONOKAI if theme == "dark" else DEFAULT_TERMINAL_THEME
    page.write_text(console.export_html(theme=colours), encoding="utf-8")
    camera.size(800, 2000)
    camera.open(page.as_uri(), "return document.readyState === 'complete'")
    return camera.picture()


def typed(command: list[str], folder: Path) -> str:
    """Return what a command prints on a terminal of 80 columns."""
    import pty
    import subprocess

    parent, child = pty.openpty()
    environment = {**os.environ, "COLUMNS": "80", "TERM": "xterm-256color", "TMPDIR": str(folder)}
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "dancedata", *command], stdout=child, stderr=child, stdin=child, env=environment
    )
    os.close(child)
    printed = b""
    with open(parent, "rb", closefd=True) as lines:
        while True:
            try:
                part = os.read(lines.fileno(), 4096)
            except OSError:  # the end of a terminal
                break
            if not part:
                break
            printed += part
    process.wait()
    # What a carriage return wrote over is not seen.
    return "\n".join(line.rpartition("\r")[2] for line in printed.decode().replace("\r\n", "\n").split("\n"))


#: Returns a picture in a theme.
Shot = Callable[[Camera, Data, str], Image.Image]
#: Pictures that the pages show, in both themes.
SHOTS: dict[str, Shot] = {
    "viewer": lambda camera, data, theme: viewer(camera, data, theme, LONG, "&t=21.30&loop=600-750&body=2"),
    "viewer-flags": lambda camera, data, theme: viewer(camera, data, theme, FLAGGED, "&t=5.80&mirror=1&body=2"),
    "viewer-narrow": lambda camera, data, theme: viewer(
        camera, data, theme, LONG, "&t=21.30&body=2", size=(420, 1000)
    ),
    "viewer-compare": lambda camera, data, theme: viewer(
        camera, data, theme, FLAGGED, "&t=5.80&with=smoothed&over=1&body=2"
    ),
    "viewer-duet": duet,
    "viewer-wall": wall,
    "report": report,
    "report-music": lambda camera, data, theme: report(camera, data, theme, "r-s-music"),
    "report-poses": poses,
    "report-against": against,
    "report-samples": samples,
}
_SIZES = {"laptop": (1366, 625), "hd": (1280, 720), "tablet": (800, 900), "phone": (420, 860)}
#: Pictures that no page shows, in dark.
LOOKS: dict[str, Shot] = {
    **{
        f"body-{name}": lambda camera, data, theme, k=k: viewer(camera, data, theme, LONG, f"&t=21.30&body={k}")  # type: ignore[misc]
        for k, name in enumerate(("sticks", "limbs", "skin"))
    },
    **{
        f"{name}": lambda camera, data, theme, size=size: viewer(camera, data, theme, LONG, "&t=21.30", size=size)  # type: ignore[misc]
        for name, size in _SIZES.items()
    },
    **{
        f"wall-12-{name}": lambda camera, data, theme, size=size: wall_of_twelve(camera, data, theme, size)  # type: ignore[misc]
        for name, size in _SIZES.items()
    },
    "skin-fingers": lambda camera, data, theme: motion(
        camera, theme, next((data.shared / "finedance").glob("*.npy")), "&t=2&body=2", fps="30"
    ),
    "skin-bvh": lambda camera, data, theme: motion(
        camera, theme, data.shared / "bvh" / "cmu_01_01.bvh", "&t=4&body=2"
    ),
    "study": study,
    "grey": lambda camera, data, _: grey(viewer(camera, data, "light", LONG, "&t=21.30")),
    "report-real": real,
    "report-samples-phone": lambda camera, data, theme: samples(camera, data, theme, (420, 2000)),
    "terminal": terminal,
}


#: Colours above which a palette of even steps is better: the shades of a skin.
_SHADES = 5_000


def save(picture: Image.Image, path: Path) -> None:
    """Write a PNG with a palette."""
    colours, place, counts = np.unique(
        np.asarray(picture).reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
    )
    if len(colours) > _SHADES:
        picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)
        print(f"{path.name}: {picture.width} x {picture.height}, {path.stat().st_size / 1000:.0f} kB")
        return
    # The most frequent colours unchanged, then those farthest from them all: a ring has few pixels.
    chosen = np.argsort(-counts, kind="stable")[:200].tolist()
    values = colours.astype(np.int32)
    distance = np.min([np.square(values - values[k]).sum(axis=1) for k in chosen], axis=0)
    while len(chosen) < 256 and distance.any():
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.square(values - values[chosen[-1]]).sum(axis=1))
    palette = colours[chosen]
    nearest = np.square(values[:, None] - values[chosen]).sum(axis=2).argmin(axis=1).astype(np.uint8)
    small = Image.fromarray(nearest[place.reshape(-1)].reshape(picture.height, picture.width), "P")
    small.putpalette(palette.tobytes())
    small.save(path, optimize=True)
    print(f"{path.name}: {picture.width} x {picture.height}, {path.stat().st_size / 1000:.0f} kB")


def main(shared: Path, names: list[str], out: Path = HERE) -> None:
    """Build the data and take the pictures."""
    with tempfile.TemporaryDirectory() as folder:
        data, camera = build(shared, Path(folder)), Camera()
        try:
            for name in names:
                if name in LOOKS:
                    save(LOOKS[name](camera, data, "dark"), out / f"{name}.png")
                    continue
                for theme, suffix in (("light", ""), ("dark", "-dark")):
                    save(SHOTS[name](camera, data, theme), out / f"{name}{suffix}.png")
        finally:
            camera.driver.quit()


if __name__ == "__main__":
    if len(sys.argv) < 2 or set(sys.argv[2:]) - {"all", *SHOTS, *LOOKS}:
        sys.exit(f"usage: python docs/images/shoot.py SHARED [all | {' | '.join([*SHOTS, *LOOKS])} ...]")
    if "all" in sys.argv[2:] or LOOKS.keys() & set(sys.argv[2:]):
        Path("pictures").mkdir(exist_ok=True)
        main(Path(sys.argv[1]), [*SHOTS, *LOOKS] if "all" in sys.argv else sys.argv[2:], Path("pictures"))
    else:
        main(Path(sys.argv[1]), sys.argv[2:] or list(SHOTS))
