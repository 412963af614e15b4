"""First paint, first figure, pictures per second and files of the viewer, by body, in one run.

    python benchmarks/drawing.py                                # this version, on the demo
    python benchmarks/drawing.py --tree ../before --rounds 5    # in turn with another working tree
    python benchmarks/drawing.py --minutes 30                   # on one clip of 30 minutes
    python benchmarks/drawing.py --files                        # seconds and bytes of pages and videos
    python benchmarks/drawing.py DATASET --clip ID --throttle 4  # another dataset, a machine four times as slow

Each tree builds its own dataset, as formats differ, unless a DATASET is given that all of them read. A chromium that
runs already, without a GPU, opens the page of `dancedata view` at 1366 x 768. First paint and first figure are from
the start of the navigation, the server warm; pictures per second are those that the page draws while it plays for
--seconds. A tree without `B` has sticks only. Files are of the first clip of the demo, 13.5 s, music embedded in the
second one, video of 1280 x 720; seconds are of the whole command. It prints medians and asserts nothing.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from features import print_machine
from pages import FIRST

from dancedata.synthetic import synthesise_motion

#: Draws for some seconds of play; returns pictures per second, and milliseconds of script per picture.
PLAY = """
const [seconds, done] = arguments, v = dancedataViewer;
v.seek(0); v.setLoop(null);
v.play(true).then(() => {
  let pictures = 0, last = -1; const begun = performance.now();
  const look = () => {
    if (v.state.t !== last) pictures++;
    last = v.state.t;
    if (performance.now() - begun < 1000 * seconds) requestAnimationFrame(look);
    else { v.play(false); done(1000 * pictures / (performance.now() - begun)); }
  };
  requestAnimationFrame(look);
});
"""


#: Samples per second of the music of a long clip.
_RATE = 16_000


def run(tree: Path, *arguments: str) -> None:
    """Run a command of a working tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-m", "dancedata", *arguments]
    subprocess.run(command, check=True, env=environment, cwd=tree, stdout=subprocess.DEVNULL)


def built(tree: Path, folder: Path, minutes: float) -> tuple[Path, Path]:
    """Build a dataset with a working tree: the demo, or one clip of some minutes; returns it and its source."""
    folder.mkdir()
    out, source = folder / "data", folder / "data-source"
    cache = ("--cache", str(folder / "cache"))
    if not minutes:
        run(tree, "build", "demo", "--out", str(out), "-q", *cache)
        return out, source
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=1800)[0]
    frames = np.arange(round(minutes * 3600)) % 1800
    (source / "motions").mkdir(parents=True)
    np.savez(
        source / "motions" / "long.npz", poses=motion.rotations.reshape(1800, 72)[frames],
        trans=motion.translation[frames], mocap_framerate=60,
    )  # fmt: skip
    (source / "music").mkdir()
    clicks = (np.arange(round(minutes * 60 * _RATE)) % (_RATE // 2) < 100).astype(np.float32)
    soundfile.write(source / "music" / "long.wav", clicks, _RATE, subtype="PCM_16")
    (folder / "long.yaml").write_text(
        "recipe: 1\nname: long\ndataset: {folder: {fps: 60, up: y, unit: m}}\n"
        "windows: {length_s: 5, stride_s: 0.5}\nmotion: {edge151: {}}\n"
    )
    run(tree, "build", str(folder / "long.yaml"), str(source), "--out", str(out), "-q", *cache)
    return out, source


def files(tree: Path, dataset: Path, source: Path, out: Path) -> dict[str, float]:
    """Return seconds and kilobytes of exported pages and of a video of the first clip."""
    from dancedata.store import open_store

    with open_store(dataset) as store:
        clip = store.clips()[0].id
    found = {}
    for name, options in (
        ("page", ("--out", "page.html")),
        ("page with music", ("--out", "music.html", "--music", str(source))),
        ("video", ("--out", "clip.mp4", "--music", str(source))),
    ):
        path = out / options[1]
        begun = time.perf_counter()
        run(tree, "view", str(dataset), clip, options[0], str(path), *options[2:], "--overwrite")
        found[f"{name} s"] = time.perf_counter() - begun
        found[f"{name} kB"] = path.stat().st_size / 1000
    return found


@contextmanager
def served(tree: Path, dataset: Path, clip: str) -> Iterator[str]:
    """Run the server of a working tree; gives its address."""
    command = [sys.executable, "-m", "dancedata", "view", str(dataset), *([clip] if clip else []), "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=tree) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)


def measure(driver: Any, address: str, seconds: float, throttle: float) -> dict[str, float]:
    """Return milliseconds to the first paint and the first figure, and pictures per second."""
    from selenium.webdriver.support.ui import WebDriverWait

    def wait(script: str) -> Any:
        return WebDriverWait(driver, 120, poll_frequency=0.05).until(lambda d: d.execute_script(script))

    driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})
    driver.get(address)
    cold = wait("return window.firstFrame")
    driver.get("about:blank")
    driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": throttle})
    driver.get(address.partition("?")[0])
    figure = wait("return window.firstFrame")
    paint = wait("return performance.getEntriesByName('first-contentful-paint')[0]?.startTime")
    wait(
        "return document.querySelector('[data-dd=root]').dataset.ready === '1' && !dancedataViewer.state.clip.partial"
    )
    found = {"first paint ms": paint, "first figure ms": figure, "of a cold server ms": cold}
    # Trees before the skin have a truth value, and before the body nothing.
    looks = driver.execute_script("const v = dancedataViewer; return v.setBody ? 3 : 'body' in v.state ? 2 : 1")
    for level, look in enumerate(("sticks", "limbs", "skin by software")[:looks]):
        driver.execute_script(
            "const v = dancedataViewer; v.setBody?.(arguments[0], true) ?? (v.state.body = arguments[0])", level
        )
        wait("return !(dancedataViewer.state.body > 1) || dancedataViewer.state.clip.figure.turning")
        found[f"{look} per second"] = driver.execute_async_script(PLAY, seconds)
    return found


def browser() -> Any:
    """Start chromium without a display."""
    os.environ["SE_OFFLINE"] = "true"
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    flags = ("headless", "disable-gpu", "no-first-run", "window-size=1366,768", "no-sandbox")
    for flag in (*flags, "autoplay-policy=no-user-gesture-required"):
        options.add_argument(f"--{flag}")
    driver = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    driver.set_script_timeout(120)
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": FIRST})
    return driver


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?")
    parser.add_argument("--clip", default="")
    parser.add_argument("--tree", type=Path, action="append", default=[])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--throttle", type=float, default=1.0)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--files", action="store_true")
    given = parser.parse_args()
    print_machine()
    trees = [*(tree.resolve() for tree in given.tree), Path(__file__).resolve().parents[1]]
    found: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    with tempfile.TemporaryDirectory() as folder:
        data = {
            tree: (given.dataset.resolve(), given.dataset.resolve())
            if given.dataset
            else built(tree, Path(folder) / str(k), given.minutes)
            for k, tree in enumerate(trees)
        }
        driver = None if given.files else browser()
        try:
            for _ in range(given.rounds):
                for tree in trees:
                    if driver is None:
                        found[tree].append(files(tree, *data[tree], Path(folder)))
                        continue
                    with served(tree, data[tree][0], given.clip) as address:
                        found[tree].append(measure(driver, address, given.seconds, given.throttle))
        finally:
            if driver is not None:
                driver.quit()
    for tree in trees:
        medians = {name: float(np.median([one[name] for one in found[tree]])) for name in found[tree][0]}
        text = "  ".join(f"{name} {value:.{1 if value < 10 else 0}f}" for name, value in medians.items())
        print(f"{tree.name:12} {text}", flush=True)


if __name__ == "__main__":
    main()
