"""Same numbers: the recipes built by two checkouts, every value compared.

    python benchmarks/values.py BASE NOW FOLDER [CASE ...]

BASE and NOW are checkouts, NOW may be this one. Each builds with its own code, reads the result with its own reader
and writes down what it read: all fields of all windows and clips, songs, starts of windows, segments, the quality of
clips, the reasons why clips were left out, minimum, maximum, mean and deviation of each field. The examples of the
readers are written and BASE is built once; FOLDER keeps them. With $DANCEDATA_SHARED the real clips of AIST++ and the
BVH files under it are built too.

Printed for each case: values compared, values that differ (NaN equals NaN), the largest difference. Exit status 1 if
one differs; means and deviations may differ by 1e-12 of the deviation, since sums may have another order.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np

AISTPP = "dataset.aist++.split=all"
EXAMPLES = {  # case: reader whose example is built, recipe, settings
    "demo": ("synthetic", "demo", ()),
    "aistpp": ("aist++", "aist++", (AISTPP,)),
    "edge-exact": ("aist++", "aist++-edge-exact", (AISTPP,)),
    "aistpp-60": ("aist++", "aist++-60", (AISTPP,)),
    "finedance": ("finedance", "finedance", ()),
    "aioz-gdance": ("aioz-gdance", "aioz-gdance", ()),
    "motorica": ("motorica", "motorica", ()),
    "dd100": ("dd100", "dd100", ()),
    "phantomdance": ("phantomdance", "phantomdance", ()),
    "i-dancers": ("i-dancers", "i-dancers", ()),
    "infinitedance": ("infinitedance", "infinitedance", ("windows.length_s=4",)),
    "popdanceset": ("popdanceset", "popdanceset", ()),
}
SHARED = {  # case: function that makes the source, recipe, settings
    "real": ("real_aistpp", "aist++", (AISTPP,)),
    "real-edge": ("real_aistpp", "aist++-edge-exact", (AISTPP,)),
    "real-lodge": ("real_aistpp", "aist++-lodge", (AISTPP,)),
    "bvh": ("real_bvh", "bvh.yaml", ()),
}
BVH = {
    "recipe": 1, "name": "bvh", "dataset": {"folder": {"music": "optional", "unit": "cm"}}, "fps": 30,
    "windows": {"length_s": 1, "stride_s": 0.5}, "retarget": {"skeleton": "smpl24"},
    "motion": {"edge151": {}, "joints": {}, "humanml263": {}},
}  # fmt: skip


def main(base: str, now: str, folder: str, *cases: str) -> int:
    """Build `cases`, all by default, with both checkouts; return 1 if a value differs."""
    work = Path(folder).resolve()
    known = [*EXAMPLES, *(SHARED if shared() else ())]
    failed = 0
    for case in cases or known:
        if not (work / "source" / source_name(case)).exists():
            child(Path(base), "source", case, work)
        for side, checkout in (("base", base), ("now", now)):
            values = work / f"{case}.{side}.h5"
            if side == "base" and values.exists():
                continue
            for made in (work / side / case, values):
                shutil.rmtree(made, ignore_errors=True)
                made.unlink(missing_ok=True)
            child(Path(checkout), "build", case, work, side)
        with h5py.File(work / f"{case}.base.h5") as a, h5py.File(work / f"{case}.now.h5") as b:
            failed += compare(case, a, b)
    return min(failed, 1)


def shared() -> Path | None:
    """Return the folder of real clips, if there is one."""
    given = os.environ.get("DANCEDATA_SHARED")
    return Path(given).resolve() if given else None


def source_name(case: str) -> str:
    """Return the name of the folder that `case` is built from."""
    return SHARED[case][0] if case in SHARED else EXAMPLES[case][0]


def child(checkout: Path, *words: object) -> None:
    """Run this file with the code of `checkout`."""
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
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


def inside(what: str, case: str, folder: str, side: str = "") -> None:
    """Make the source of `case`, or build it and write what its reader reads into one file."""
    work = Path(folder)
    source = work / "source" / source_name(case)
    if what == "source":
        part = source.with_name(f"{source.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        make_source(case, part)
        part.rename(source)
        return
    import dancedata

    recipe, settings = (SHARED if case in SHARED else EXAMPLES)[case][1:]
    if recipe.endswith(".yaml"):
        (work / recipe).write_text(json.dumps(BVH))
        recipe = str(work / recipe)
    out, cache = work / side / case, work / side / "cache"
    places = ["--source", source, "--out", out, "--cache", cache]
    words = [sys.executable, "-m", "dancedata", "build", recipe, *(f"--set={s}" for s in settings), *map(str, places)]
    subprocess.run([*words, "--quiet"], check=True, stdout=subprocess.DEVNULL)
    made = work / f"{case}.{side}.h5"
    with h5py.File(made.with_suffix(".part"), "w") as file:
        write_values(dancedata.open(out), file)
    made.with_suffix(".part").rename(made)


def make_source(case: str, source: Path) -> None:
    """Write the example of the reader, or lay real files out as the reader wants them."""
    if case in SHARED:
        globals()[SHARED[case][0]](shared(), source)
        return
    from dancedata.core.registry import DATASETS

    DATASETS.get(EXAMPLES[case][0])().make_example(source)


def real_aistpp(real: Path, source: Path) -> None:
    """Lay the four real dances out with 35 s of real songs, whose own music may not be passed on."""
    import soundfile

    for name in ("motions", "splits", "cameras"):
        shutil.copytree(real / "realdata/aistpp" / name, source / name)
    shutil.copy(real / "realdata/aistpp/ignore_list.txt", source)
    (source / "wavs").mkdir()
    songs = sorted((real / "realdata/music").glob("*.ogg"))
    for i, music in enumerate(("mBR2", "mJS2", "mJS4")):
        samples, rate = soundfile.read(songs[i % len(songs)], frames=35 * 44100)
        soundfile.write(source / "wavs" / f"{music}.wav", samples, rate, subtype="PCM_16")


def real_bvh(real: Path, source: Path) -> None:
    """Lay the real BVH files out as a folder."""
    for file in sorted((real / "realdata/bvh").glob("*.bvh")):
        shutil.copy(file, source)


def write_values(store: Any, file: h5py.File) -> None:
    """Write everything that the reader gives."""
    from dancedata.core.errors import StoreError, UsageError

    for clip in store.clips:
        group = file.create_group(f"clips/{clip.id}")
        windows = store.windows_of(clip.id)
        group["starts"] = np.array([w.start for w in windows])
        group["segments"] = "\n".join(sorted(repr(s) for s in store.segments(clip.id)))
        for name in store.fields:
            group[f"has/{name}"] = int(store.has_field(clip.id, name))
            if not store.has_field(clip.id, name):
                continue
            for what, read in (("clip", clip.read), ("song", clip.read_song)):
                try:
                    values = read(name)
                except (StoreError, UsageError):  # only windows are kept, or the field is not of a song
                    continue
                group[f"{what}/{name}"] = values
            for window in windows:
                group[f"windows/{name}/{window.start}"] = store.read(window, name)
    file["rejects"] = "\n".join(sorted(f"{r['reason']} {r.get('clip')} {r.get('window')}" for r in store.rejects))
    file["quality"] = "\n".join(sorted(json.dumps(q, sort_keys=True) for q in store.quality))
    for name, stats in store.stats["fields"].items():
        for key in ("mean", "std", "min", "max"):  # codes have none of them
            if key not in stats:
                continue
            file[f"stats/{name}/{key}"] = np.array(stats[key], dtype=np.float64)


if __name__ == "__main__":
    if sys.argv[1] == "--":
        inside(*sys.argv[2:])
    else:
        sys.exit(main(*sys.argv[1:]))
