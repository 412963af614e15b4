"""Memory, size and time of `dancedata view` and `dancedata report` on as many clips as AIST++ has.

    python benchmarks/pages.py                      # 1,408 clips: the demo's, under other names
    python benchmarks/pages.py --clips 100
    python benchmarks/pages.py --dataset DIR --source DIR     # a dataset of your own
    python benchmarks/pages.py --first-frame 5      # also the first picture in chromium, the least of five

Memory is the peak resident set of the process (VmHWM, getrusage). The server answers the page, every 20th clip with
its music, and the order by sliding, for which it reads all clips. It prints measurements and asserts nothing; the
limits are 300 MB for both, 1 MB for the page of the server, and 20 MB for a report. First frame: from the start of
the navigation to the first picture of the dancer, in a chromium that runs already.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.cookiejar import CookieJar
from pathlib import Path

import numpy as np
from features import print_machine

from dancedata.store import Store, StoredClip, open_store
from dancedata.store.schema import StoreHeader
from dancedata.store.stored_clip import AudioBlock
from dancedata.store.writer import write_store

#: Clips of AIST++; every how manieth is opened.
CLIPS, EVERY = 1408, 20
MB = 1e6


def write_many(demo: Path, out: Path, n: int) -> Path:
    """Write the clips of the demo again and again, under other names."""
    out.mkdir()
    with open_store(demo) as store:
        kept = [_stored(store, k) for k in range(len(store))]
        clips = [replace(kept[k % len(kept)], id=f"{kept[k % len(kept)].id}_{k:04d}") for k in range(n)]
        keys = ("name", "licence", "citation", "recipe", "versions", "source")
        about = {key: store.info[key] for key in keys if key in store.info}
        windows = store.info["windows"]["length"], store.info["windows"]["stride"]
        fields = tuple(store.field(name) for name in store.fields)
        write_store(out, StoreHeader(store.grid.rate, *windows, fields, store.skeleton, meta=about), clips)
    return out


def _stored(store: Store, number: int) -> StoredClip:
    clip = store.clips()[number]
    starts = tuple(w.start for w in store.windows(clip.split) if w.clip == clip.id)
    song = np.asarray(clip.read_song("librosa35"))
    audio = {"librosa35": AudioBlock(clip.music, song)}
    return StoredClip(**vars(clip.record), starts=starts, motion={"edge151": clip.read("edge151")}, audio=audio)


def print_report(dataset: Path, folder: Path) -> None:
    """Print time, memory and size of a report."""
    page = folder / "report.html"
    begun, before = time.perf_counter(), _cpu_s()
    # A separate process between the two, as the peak of all children is kept.
    code = (
        "import resource, subprocess, sys\nsubprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [sys.executable, "-m", "dancedata", "report", str(dataset), "--out", str(page)]
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True)
    took, cpu_s = time.perf_counter() - begun, _cpu_s() - before
    print(
        f"report       {int(done.stdout) * 1024 / MB:6.0f} MB peak  {page.stat().st_size / MB:6.2f} MB page  "
        f"{took:6.1f} s  {cpu_s:6.1f} CPU s",
        flush=True,
    )


def _cpu_s() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


@contextmanager
def served(dataset: Path, source: Path | None) -> Iterator[tuple[int, str]]:
    """Run the server; gives its process id and its address."""
    command = [sys.executable, "-m", "dancedata", "view", str(dataset), "--no-browser"]
    command += [] if source is None else ["--music", str(source)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.pid, process.stdout.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)


def print_view(dataset: Path, source: Path | None) -> None:
    """Print the memory of the server after each kind of request, and the size of its page."""
    with served(dataset, source) as (process, address):
        client = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))
        base = address.partition("?")[0]

        def get(path: str) -> bytes:
            return bytes(client.open(base + path).read())

        page = bytes(client.open(address.partition("#")[0]).read())
        names = json.loads(re.search(r'id="dd-data">(.*?)</script>', page.decode(), flags=re.DOTALL)[1])  # type: ignore[index]
        n = len(names["list"]["items"])
        print(f"view         {peak_mb(process):6.0f} MB peak  {len(page) / MB:6.2f} MB page, {n:,} clips", flush=True)
        for number in range(0, n, EVERY):
            get(f"clip/{number}")
            if source is not None:
                get(f"clip/{number}/music")
        print(f"  clips      {peak_mb(process):6.0f} MB peak, {len(range(0, n, EVERY))} clips opened", flush=True)
        begun = time.perf_counter()
        while not json.loads(get("sliding"))["done"]:
            time.sleep(0.2)
        print(f"  sliding    {peak_mb(process):6.0f} MB peak  {time.perf_counter() - begun:6.1f} s", flush=True)


def peak_mb(process: int) -> float:
    """Return the peak resident set of a process."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * 1024 / MB


#: Notes when the page has drawn its first clip, in milliseconds after the start of the navigation.
FIRST = """
const look = () => {
  const v = window.dancedataViewer;
  if (v && v.state.clip && v.state.clip.figure && !v.state.dirty) window.firstFrame = performance.now();
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
#: True if the picture has more than one colour.
DRAWN = """
const c = document.querySelector('[data-dd=figure]');
const d = new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer);
return d.some(value => value !== d[0]);
"""


def print_first_frame(dataset: Path, source: Path | None, rounds: int) -> None:
    """Print the milliseconds from the start of a navigation to the first picture."""
    os.environ["SE_OFFLINE"] = "true"
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for flag in ("headless", "disable-gpu", "no-first-run", "window-size=1440,900", "no-sandbox"):
        options.add_argument(f"--{flag}")
    driver = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": FIRST})
    found = []
    try:
        for _ in range(rounds):
            with served(dataset, source) as (_, address):
                driver.get(address)
                wait = WebDriverWait(driver, 60, poll_frequency=0.05)
                found.append(wait.until(lambda d: d.execute_script("return window.firstFrame")))
                if not driver.execute_script(DRAWN):
                    raise RuntimeError("the picture is empty")
    finally:
        driver.quit()
    print(
        f"first frame  {min(found):6.0f} ms least, {np.median(found):.0f} ms median of {rounds}, "
        f"{max(found):.0f} ms most (load {os.getloadavg()[0]:.1f})",
        flush=True,
    )


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=CLIPS)
    parser.add_argument("--dataset", type=Path)
    parser.add_argument("--source", type=Path)
    parser.add_argument("--first-frame", type=int, default=0, metavar="ROUNDS")
    given = parser.parse_args()
    print_machine()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dataset, source = given.dataset, given.source
        if dataset is None:
            command = [sys.executable, "-m", "dancedata", "build", "demo", "--out", str(folder / "demo"), "--quiet"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            dataset, source = (
                write_many(folder / "demo", folder / "many", given.clips),
                folder / "demo-source" / "wavs",
            )
        print_report(dataset, folder)
        print_view(dataset, source)
        if given.first_frame:
            print_first_frame(dataset, source, given.first_frame)


if __name__ == "__main__":
    main()
