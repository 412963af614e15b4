"""Checks by building a tiny dataset: its bytes, its numbers, and reading it back."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.hashing import sha256_file
from dancedata.core.packages import version
from dancedata.doctor.finding import Finding, failed, note, ok
from dancedata.execution.reference_process import expected
from dancedata.formats.arrays import open_arrays

#: Whose versions shape the bytes of the dataset.
PACKAGES = ("numpy", "scipy", "soxr", "h5py", "soundfile", "librosa")
_SPLIT = "all"
#: Two songs, four clips of 5 s.
RECIPE = {
    "recipe": 1,
    "name": "doctor",
    "dataset": {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 5, "split": _SPLIT}},
    "fps": 30,
    "windows": {"length_s": 4, "stride_s": 0.5},
    "motion": {"edge151": {}},
    "audio": {"librosa35": {}},
}
#: Rows of the reference, of the first window.
N_ROWS = 24
#: Largest difference from the reference, by group of columns; the others have to be equal.
_TOLERANCES = {"edge151": {"": 1e-5}, "librosa35": {"onset_envelope": 1e-3, "mfcc": 1e-2, "chroma_cens": 1e-4}}
_FILE = Path(__file__).with_name("reference")


@dataclass(frozen=True)
class Reference:
    """What the tiny dataset is on a machine that was checked.

    Attributes
    ----------
    made_with
        Versions and instructions that its bytes hold for.
    shards
        SHA-256 of its shards.
    rows
        By field, the first rows of its first window: (24, D).
    """

    made_with: Mapping[str, str]
    shards: Mapping[str, str]
    rows: Mapping[str, npt.NDArray[np.float32]]


@lru_cache(maxsize=1)
def reference() -> Reference:
    """Return the reference that is part of the package."""
    about = json.loads(_FILE.with_suffix(".json").read_text(encoding="utf-8"))
    with open_arrays(_FILE.with_suffix(".npz")) as arrays:
        rows = {name: arrays.read(name).astype(np.float32) for name in arrays.names}
    return Reference(about["made_with"], about["shards"], rows)


def made_with() -> dict[str, str]:
    """Return what shapes the bytes of a dataset here."""
    return {
        **{name: version(name) for name in PACKAGES},
        "C library": " ".join(platform.libc_ver()),
        "arithmetic": expected(),
    }


def build_sample(folder: Path) -> Path:
    """Build the dataset in a folder, with a cache of its own, by two worker processes; returns its path."""
    from dancedata.api.commands import build

    return build(RECIPE, folder / "source", folder / "dataset", jobs=2, cache=folder / "cache", progress=False).path


def check_bits(dataset: Path, known: Reference) -> Iterator[Finding]:
    """Compare the bytes of the shards, where versions are those of the reference."""
    here = made_with()
    other = [f"{name} {here[name]}, not {value}" for name, value in known.made_with.items() if here[name] != value]
    found = {path.name: sha256_file(path) for path in sorted(dataset.glob("*.h5"))}
    if other:
        yield note("bytes", f"not compared, as they are known for other versions: {'; '.join(other)}")
    elif found != known.shards:
        names = ", ".join(name for name in known.shards if found.get(name) != known.shards[name])
        fix = "install the packages again (pip install --force-reinstall): one of them is not what its version says"
        yield failed("bytes", f"a small dataset has other bytes than it should have: {names}", fix)
    else:
        yield ok("bytes", "a small dataset, built by two workers, has the expected SHA-256")


def check_numbers(dataset: Path, known: Reference) -> Iterator[Finding]:
    """Compare the first rows of a window of motion and of music with the reference, within tolerances."""
    from dancedata.store import open_store

    problems = []
    with open_store(dataset) as store:
        window = store.windows(_SPLIT)[0]
        for name, rows in known.rows.items():
            found = np.asarray(store.read(window, name))[: len(rows)]
            columns = store.fields[name]
            for group in columns.names:
                allowed = _TOLERANCES[name].get(group, _TOLERANCES[name].get("", 0.0))
                difference = _difference(found, rows, columns.slice(group))
                if not difference <= allowed:
                    problems.append(f"{name}.{group} differs by {difference:.2g}, at most {allowed:g} is allowed")
    if problems:
        fix = "install the versions of constraints.txt; if it stays, report it with the output of doctor --json"
        yield failed("numbers", "; ".join(problems), fix)
    else:
        yield ok("numbers", "edge151 and librosa35 are those of the reference")


def _difference(found: npt.NDArray[Any], rows: npt.NDArray[Any], group: slice) -> float:
    if found.shape != rows.shape:
        return float("inf")
    return float(np.abs(found[:, group].astype(np.float64) - rows[:, group]).max())


def check_reading(dataset: Path) -> Iterator[Finding]:
    """Verify the dataset, and read it with numpy."""
    from dancedata.store import verify_store

    errors = [str(problem) for problem in verify_store(dataset) if problem.severity == "error"]
    if errors:
        yield failed("reading", "; ".join(errors), "report it: a dataset that was just built is not valid")
    else:
        yield ok("reading", f"{len(_windows(dataset))} windows, verified and read with numpy")


def check_torch(dataset: Path) -> Iterator[Finding]:
    """Read the dataset with torch, if that is installed, and compare."""
    try:
        version("torch")
    except ModuleNotFoundError:
        return  # the extra's own line has said so
    from dancedata.readers import WindowDataset

    windows = WindowDataset(dataset, split=_SPLIT, fields=("edge151",), normalize=False)
    rows = _windows(dataset)
    if len(windows) == len(rows) and all(np.array_equal(windows[k]["edge151"], r) for k, r in enumerate(rows)):
        yield ok("torch", f"WindowDataset reads the same {len(rows)} windows")
    else:
        yield failed(
            "torch", "WindowDataset reads other values than numpy", "report it with the output of doctor --json"
        )


def _windows(dataset: Path) -> list[npt.NDArray[Any]]:
    from dancedata.store import open_store

    with open_store(dataset) as store:
        return [np.asarray(store.read(window, "edge151")) for window in store.windows(_SPLIT)]


def write_reference(dataset: Path) -> None:
    """Write the reference of the package from a dataset that `build_sample` has built."""
    from dancedata.store import open_store

    shards = {path.name: sha256_file(path) for path in sorted(dataset.glob("*.h5"))}
    about = {"made_with": made_with(), "shards": shards}
    _FILE.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    with open_store(dataset) as store:
        window = store.windows(_SPLIT)[0]
        rows = {name: np.asarray(store.read(window, name))[:N_ROWS] for name in store.fields}
    np.savez_compressed(_FILE.with_suffix(".npz"), **rows)  # type: ignore[arg-type]
