"""What every system has to do: open, read, build, check, export, evaluate, view and replace a dataset.

``python -m tests.platforms.core FOLDER`` does it in a new folder with the installed package and prints the hashes of
the dataset's files. Needs no torch. `tests/platforms/test_modes.py` runs it without some calls of the system,
`.ci/arm64` under an emulator, and the workflows in .github on each system.
"""

import json
import os
import sys
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urljoin

if __name__ == "__main__":
    from dancedata.execution.arithmetic import adopt

    adopt()

import numpy as np

import dancedata
from dancedata.core import system
from dancedata.core.errors import StoreError
from dancedata.execution.reference_process import expected
from dancedata.files.locks import writing_lock
from dancedata.files.regular_file import sha256_file

#: Four clips of 5 s to two songs, in two splits.
TINY = {
    "dataset.synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 5, "split": "all"},
    "windows": {"length_s": 4, "stride_s": 0.5},
}


def run(folder: Path, jobs: int = 2) -> dict[str, str]:
    """Do everything in a new folder; return the hashes of the dataset's files by name."""
    cache, out = folder / "cache", folder / "data" / "tiny"
    options = {"overrides": TINY, "jobs": jobs, "cache": cache, "progress": False}
    dancedata.build("demo", folder / "source", out, **options)
    hashes = {path.name: sha256_file(path) for path in sorted(out.iterdir())}
    check(out)
    read(out)
    replace(out, folder / "source", options)
    assert {path.name: sha256_file(path) for path in sorted(out.iterdir())} == hashes
    export(out, folder)
    evaluate(out, cache)
    view(out, folder / "source")
    left = [path.name for name in ("tmp", "locks") for path in (cache / name).iterdir()]
    assert left == [], f"left in the cache: {left}"
    assert [path.name for path in out.parent.iterdir()] == ["tiny"]
    return hashes


def check(out: Path) -> None:
    """Compare hashes, bounds and numbers."""
    errors = [str(problem) for problem in dancedata.check(out, progress=False) if problem.severity == "error"]
    assert errors == []


def read(out: Path) -> None:
    """Read every window by position and from the mapped file: the same rows."""
    ds = dancedata.open(out)
    windows = ds.windows(ds.splits[0])
    for field in ("edge151", "librosa35"):
        first = ds.read(windows[0], field)
        for mapped in (True, False):
            rows = ds.window_rows(windows, field, mapped=mapped)
            assert bool(rows.unmapped) is not mapped
            rows.read_ahead(range(len(windows)))
            batch = np.empty((len(windows), *rows.shape), rows.dtype)
            with ThreadPoolExecutor(4) as threads:
                list(threads.map(rows.read_into, range(len(windows)), batch))
            np.testing.assert_array_equal(batch, np.stack([ds.read(window, field) for window in windows]))
            np.testing.assert_array_equal(batch[0], first)


def replace(out: Path, source: Path, options: dict[str, object]) -> None:
    """Build again over the dataset; while another process writes there, it is refused."""
    before = {path.name: sha256_file(path) for path in out.iterdir()}
    with writing_lock(out, "build"):
        try:
            dancedata.build("demo", source, out, overwrite=True, **options)
            refused = ""
        except StoreError as error:
            refused = error.problem
    has_locks = system._fcntl is not None or system._msvcrt is not None
    assert refused == ("another build is writing there" if has_locks else "")
    assert {path.name: sha256_file(path) for path in out.iterdir()} == before
    dancedata.build("demo", source, out, overwrite=True, **options)


def export(out: Path, folder: Path) -> None:
    """Write the files of a trainer."""
    dancedata.export(out, "npz", folder / "npz", progress=False)
    assert list((folder / "npz").rglob("*.npz"))


def evaluate(out: Path, cache: Path) -> None:
    """Measure the dances."""
    report = dancedata.evaluate(out, cache=cache)
    assert len(report.clips) == 4


def view(out: Path, source: Path) -> None:
    """Serve the dataset, and fetch the page, a clip and its music."""
    from dancedata.viewer.view import ViewRequest
    from tests.viewer.helpers import serving

    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with serving(ViewRequest(out, source=source)) as address:
        for path in (address, urljoin(address, "/clip/0"), urljoin(address, "/clip/0/music")):
            with browser.open(path, timeout=60) as answer:
                assert answer.status == 200
                assert answer.read()


def main() -> None:
    """Run it, and print a JSON document."""
    os.environ["PATH"] = ""  # small images have no programs, such as pgrep, which loky calls without psutil
    hashes = run(Path(sys.argv[1]), jobs=int(sys.argv[2]) if len(sys.argv) > 2 else 2)
    print(json.dumps({"system": sys.platform, "arithmetic": expected(), "files": hashes}, indent=1, sort_keys=True))


if __name__ == "__main__":
    main()
