"""First paint, first figure, and pictures per second of the viewer's page, by body, in one run.

    python benchmarks/drawing.py DATASET                              # this version
    python benchmarks/drawing.py DATASET --tree ../before --rounds 5   # in turn with another working tree
    python benchmarks/drawing.py DATASET --clip ID --throttle 4        # a machine four times as slow

A chromium that runs already, without a GPU, opens the page of `dancedata view` at 1366 x 768. First paint and first
figure are from the start of the navigation, the server warm; pictures per second are those that the page draws while
it plays for --seconds. A tree without `B` has sticks only. It prints medians and asserts nothing.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from features import print_machine
from pages import FIRST

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
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--clip", default="")
    parser.add_argument("--tree", type=Path, action="append", default=[])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--throttle", type=float, default=1.0)
    given = parser.parse_args()
    print_machine()
    trees = [*(tree.resolve() for tree in given.tree), Path(__file__).resolve().parents[1]]
    found: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    driver = browser()
    try:
        for _ in range(given.rounds):
            for tree in trees:
                with served(tree, given.dataset.resolve(), given.clip) as address:
                    found[tree].append(measure(driver, address, given.seconds, given.throttle))
    finally:
        driver.quit()
    for tree in trees:
        medians = {name: np.median([one[name] for one in found[tree]]) for name in found[tree][0]}
        print(f"{tree.name:12} " + "  ".join(f"{name} {value:.0f}" for name, value in medians.items()), flush=True)


if __name__ == "__main__":
    main()
