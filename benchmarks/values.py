"""Same numbers: the recipes built by two checkouts, every value compared.

    python benchmarks/values.py BASE NOW FOLDER [CASE ...]

BASE and NOW are checkouts, NOW may be this one. Each builds with its own code, reads the result with its own reader
and writes down what it read: all fields of all windows and clips, songs, starts of windows, segments, the quality
of clips, the reasons why clips were left out, minimum, maximum, mean and deviation of each field. Sources are made
and BASE is built once; FOLDER keeps them. The cases are in value_cases.py. With $DANCEDATA_SHARED real clips of
AIST++ and the BVH files under it are built too.

Printed for each case: values compared, values that differ (NaN equals NaN), the largest difference. Exit status 1 if
one differs; means and deviations may differ by 1e-12 of the deviation, since sums may have another order.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from value_cases import cases, make_source

#: Of a clip's columns these may be counted otherwise: places in tables, hashes of the code.
NOT_COMPARED = {"licence", "made_of", "slice_of", "slice_start"}


def main(base: str, now: str, folder: str, *names: str) -> int:
    """Build the cases `names`, all by default, with both checkouts; return 1 if a value differs."""
    work = Path(folder).resolve()
    known, failed = cases(), 0
    for case in names or known:
        if not (work / "source" / known[case].source).exists():
            child(Path(base), "source", case, work)
        for side, checkout in (("base", base), ("now", now)):
            values = work / f"{case}.{side}.h5"
            if side == "base" and values.exists():
                continue
            for made in (work / side / case, values):
                shutil.rmtree(made, ignore_errors=True)
                made.unlink(missing_ok=True)
            child(Path(checkout), "build", case, work, side, "base" if Path(checkout).samefile(base) else "now")
        with h5py.File(work / f"{case}.base.h5") as a, h5py.File(work / f"{case}.now.h5") as b:
            wrong = compare(case, a, b)
        print(f"    on purpose: {known[case].differs}\n" if known[case].differs else "", end="")
        failed += 0 if known[case].differs else wrong
    return min(failed, 1)


def child(checkout: Path, *words: object) -> None:
    """Run this file with the code of `checkout`."""
    environment = {**os.environ, "PYTHONPATH": f"{checkout.resolve()}{os.pathsep}{Path(__file__).parent}"}
    command = [sys.executable, "-P", __file__, "--", *map(str, words)]
    subprocess.run(command, check=True, env=environment, cwd=checkout)


def compare(case: str, a: h5py.File, b: h5py.File) -> int:
    """Print how `b`'s values differ from `a`'s; return 1 if they do."""
    names: list[set[str]] = []
    for file in (a, b):
        found: set[str] = set()
        file.visititems(lambda name, item, found=found: found.add(name) if isinstance(item, h5py.Dataset) else None)
        names.append(found)
    lost, new, total, differ, worst, lines = names[0] - names[1], names[1] - names[0], 0, 0, 0.0, []
    for name in sorted(names[0] & names[1]):
        x, y = a[name][()], b[name][()]
        if not isinstance(x, np.ndarray):
            total += 1
            if x != y:
                differ += 1
                lines.append(f"    {name}: {str(x)[:120]} / {str(y)[:120]}")
            continue
        total += x.size
        if x.shape != y.shape or x.dtype != y.dtype:
            differ += max(x.size, 1)
            lines.append(f"    {name}: {x.shape} {x.dtype} / {y.shape} {y.dtype}")
            continue
        gap = np.abs(np.where(x == y, 0, np.float64(x) - np.float64(y)))
        gap[np.isnan(x) & np.isnan(y)] = 0
        where, _, what = name.rpartition("/")
        allowed = 1e-12 * np.abs(a[f"{where}/std"][()]) if what in ("mean", "std") else 0
        wrong = ~(gap <= allowed)
        if wrong.any():
            differ += int(wrong.sum())
            worst = max(worst, float(np.nanmax(gap)))
            lines.append(f"    {name}: {int(wrong.sum())} of {x.size} differ, by up to {np.nanmax(gap):.3g}")
    print(f"{case}: {total} values in {len(names[0] & names[1])} arrays, {differ} differ, worst {worst:.3g}, "
          f"{len(lost)} lost, {len(new)} new", *lines[:12], *(f"    lost {n}" for n in sorted(lost)[:6]),
          *(f"    new {n}" for n in sorted(new)[:6]), sep="\n", flush=True)  # fmt: skip
    return int(bool(lines or lost or new))


# ---- with the code of one checkout


def inside(what: str, case: str, folder: str, side: str = "", words: str = "") -> None:
    """Make the source of `case`, or build it and write what its reader reads into one file."""
    work = Path(folder)
    source = work / "source" / cases()[case].source
    if what == "source":
        part = source.with_name(f"{source.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        make_source(source.name, part)
        part.rename(source)
        return
    import dancedata

    out, cache = work / side / case, work / side / "cache"
    recipe, settings = cases()[case].chosen_recipe(work / f"recipes-{words}" / case, words == "base")
    places = [*(["--source"] if words == "base" else []), source, "--out", out, "--cache", cache]
    command = [sys.executable, "-m", "dancedata", "build", recipe, *(f"--set={s}" for s in settings)]
    subprocess.run([*command, *map(str, places), "--quiet"], check=True, stdout=subprocess.DEVNULL)
    made = work / f"{case}.{side}.h5"
    with h5py.File(made.with_suffix(".part"), "w") as file:
        write_values(dancedata.open(out), file)
    made.with_suffix(".part").rename(made)


def write_values(store: Any, file: h5py.File) -> None:
    """Write everything that the reader gives; of slices, which may be windows or clips of their own, the rows."""
    is_base = hasattr(store, "windows_of")  # which has other names for some
    stride = (store.window_grid if is_base else store._window_grid)().stride
    for clip in store:
        windows = store.windows_of(clip.id) if is_base else store[clip.id].windows()
        parent = clip.source or clip.id
        if getattr(store, "scope", "track") == "window":
            for window in windows:
                name = f"{parent}_slice{window.start // stride}{clip.id.removeprefix(parent)}"
                write_slice(store, window, file.create_group(f"slices/{name}"))
        elif re.search(r"_slice\d+", clip.id):
            write_slice(store, *windows, file.create_group(f"slices/{clip.id}"))
        else:
            write_clip(store, clip, windows, file.create_group(f"clips/{clip.id}"))
    sliced = "slices" in file
    keys = ("reason", "clip") if sliced else ("reason", "clip", "window")
    rejects = [" ".join(str(row.get(key)) for key in keys) for row in store.rejects]
    file["rejects"] = "\n".join(sorted(re.sub(r"_slice\d+", "", row) for row in rejects))
    if not sliced:  # flags of slices that overlap are told for each of them
        file["quality"] = "\n".join(sorted(json.dumps(q, sort_keys=True) for q in store.quality))
    for name, stats in store.stats["fields"].items():
        for key in ("mean", "std", "min", "max"):  # codes have none of them
            if key not in stats:
                continue
            file[f"stats/{name}/{key}"] = np.array(stats[key], dtype=np.float64)


def write_slice(store: Any, window: Any, group: h5py.Group) -> None:
    """Write the rows of a slice."""
    for name in store.fields:
        group[name] = store.read(window, name)


def write_clip(store: Any, clip: Any, windows: Any, group: h5py.Group) -> None:
    """Write columns, segments and rows of a clip, its song and its windows."""
    from dancedata.core.errors import StoreError, UsageError
    from dancedata.store.clip_columns import ClipRecord

    for column in fields(ClipRecord):
        if column.name not in NOT_COMPARED:
            group[f"columns/{column.name}"] = repr(getattr(clip, column.name))
    group["starts"] = np.array([w.start for w in windows])
    group["segments"] = "\n".join(sorted(repr(s) for s in store.segments(clip.id)))
    for name in store.fields:
        has_field = store.has_field(clip.id, name) if hasattr(store, "has_field") else name in store[clip.id]
        group[f"has/{name}"] = int(has_field)
        if not has_field:
            continue
        for what, read in (("clip", clip.read), ("song", clip.read_song)):
            with suppress(StoreError, UsageError):  # the field is not of a song, or the song begins late
                group[f"{what}/{name}"] = read(name)
        for window in windows:
            group[f"windows/{name}/{window.start}"] = store.read(window, name)


if __name__ == "__main__":
    if sys.argv[1] == "--":
        inside(*sys.argv[2:])
    else:
        sys.exit(main(*sys.argv[1:]))
