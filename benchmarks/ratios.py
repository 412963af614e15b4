"""Builds of two checkouts in one run: time cold and from the cache, and the largest process, NOW divided by BASE.

    python benchmarks/ratios.py BASE NOW FOLDER [CASE ...] [--rounds 5]

Cases: demo; thirty-two clips of 6 s; a folder of BVH files; groups; a clip of five minutes with four fields, three
copies, repairs, scores and facts; a corpus of AIST++'s size (1,380 clips of 13.3 s on 60 songs). Rounds alternate
between the checkouts and between who is first; medians are printed, of seconds of the wall clock, of seconds of CPU,
and of the peak resident set (MB) of the largest process. FOLDER keeps the sources.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from build import Spent, watched
from features import print_machine
from value_cases import COPIES, FOLDER, GROUPS, Case, make_source

ROUNDS = 5
MUTE = {k: v for k, v in FOLDER.items() if k != "audio"} | {
    "dataset": {"folder": {"unit": "cm", "music": "optional"}}
}


def main() -> None:
    """Print a row for each case, cold and cached."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", type=Path)
    parser.add_argument("now", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], default=[])
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    options = parser.parse_args()
    print_machine()
    print(f"{'':>14}{'':>8}{'wall s':>20}{'ratio':>7}{'CPU s':>20}{'ratio':>7}{'peak MB':>18}{'ratio':>7}")
    for name in options.cases or CASES:
        checkouts = {"base": options.base.resolve(), "now": options.now.resolve()}
        measure(name, checkouts, options.folder.resolve(), options.rounds)


def measure(name: str, checkouts: Mapping[str, Path], folder: Path, rounds: int) -> None:
    """Build a case in alternating rounds and print medians."""
    case, source = CASES[name], folder / "source" / name
    if not source.exists():
        words = [sys.executable, "-P", __file__, "--source", name, str(source)]
        subprocess.run(words, check=True, env=environment(checkouts["base"]), cwd=checkouts["base"])
    spent: dict[tuple[str, str], list[Spent]] = {}
    for side in checkouts:  # of a run that was ended
        shutil.rmtree(folder / side, ignore_errors=True)
    for turn in range(rounds):
        for side in list(checkouts)[:: 1 if turn % 2 else -1]:
            for how in ("cold", "cached"):
                spent.setdefault((how, side), []).append(build(case, source, checkouts[side], folder / side, side))
            shutil.rmtree(folder / side)
    for how in ("cold", "cached"):
        row = f"{name:>14}{how:>8}"
        for value, width in (("wall_s", 10), ("cpu_s", 10), ("largest_mb", 9)):
            base, now = (statistics.median(getattr(s, value) for s in spent[how, side]) for side in ("base", "now"))
            row += f"{base:{width}.2f}{now:{width}.2f}{now / base:7.2f}"
        print(f"{row}  (load {os.getloadavg()[0]:.1f})", flush=True)


def build(case: Case, source: Path, checkout: Path, folder: Path, side: str) -> Spent:
    """Build a case with a checkout's code, two jobs."""
    folder.mkdir(parents=True, exist_ok=True)
    recipe, settings = case.chosen_recipe(folder, side == "base")
    shutil.rmtree(folder / "out", ignore_errors=True)
    words = [sys.executable, "-P", "-m", "dancedata", "build", recipe, *(f"--set={s}" for s in settings)]
    words += [*(["--source"] if side == "base" else []), str(source)]
    words += ["--out", str(folder / "out"), "--cache", str(folder / "cache"), "--jobs", "2"]
    return watched(words, environment(checkout))


def environment(checkout: Path) -> dict[str, str]:
    """Return the environment that runs a checkout's code."""
    return {**os.environ, "PYTHONPATH": f"{checkout}{os.pathsep}{Path(__file__).parent}"}


# ---- sources, made with the code of BASE


def corpus(**sizes: Any) -> Callable[[Path], object]:
    """Return what writes a synthetic corpus."""

    def write(source: Path) -> None:
        from dancedata.synthetic import write_synthetic

        write_synthetic(source, **sizes)

    return write


def takes(ending: str, count: int, n_frames: int) -> Callable[[Path], object]:
    """Return what writes takes of synthetic dances, alone with their files."""

    def write(source: Path) -> None:
        from dancedata.synthetic import synthesise_motion
        from examples.make_captures import write_take

        for k in range(count):
            motion = synthesise_motion(f"gBR_sBM_cAll_d04_mBR0_ch{k + 1:02d}", n_frames=n_frames)[0]
            translation = np.array(motion.translation)
            translation[n_frames // 2] += (0.3, 0, 0)
            write_take(source / f"take{k:02d}{ending}", replace(motion, translation=translation))

    return write


LONG = {
    **MUTE, "repair": {"spikes": 0.15}, "curate": {"spikes": 0.05, "sliding": {"limit": 9}}, "augment": COPIES,
    "motion": {"edge151": {}, "lodge139": {}, "joints": {}}, "keymotion": {"lodge": {}}, "segments": {"facts": True},
}  # fmt: skip
CASES = {
    "demo": Case("synthetic", "demo"),
    "thirty-two": Case("", "aist++", ("dataset.aist++.split=all",)),
    "bvh": Case("", {**MUTE, "windows": {"length_s": 2, "stride_s": 0.5}, "retarget": {"skeleton": "smpl24"}}),
    "groups": Case("groups", {**GROUPS, "augment": {"mirror": True}}),
    "five-minutes": Case("", LONG),
    "aistpp-sized": Case("", "aist++", ("dataset.aist++.split=crossmodal",)),
}
WRITERS = {
    "thirty-two": corpus(songs=8, clips_per_song=4, clip_s=6),
    "bvh": takes(".bvh", 12, 1800),
    "five-minutes": takes("_poses.npz", 1, 18000),
    "aistpp-sized": corpus(songs=60, clips_per_song=23, clip_s=13.3),
}


def write_source(name: str, source: Path) -> None:
    """Write the source of a case, whole or not at all."""
    part = source.with_name(f"{source.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    if name in WRITERS:
        WRITERS[name](part)
    else:
        make_source(CASES[name].source, part)
    part.rename(source)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--source"]:
        write_source(sys.argv[2], Path(sys.argv[3]))
    else:
        main()
