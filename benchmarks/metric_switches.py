"""Effect of each switch of a metric on its value, on the clips of a copy of AIST++.

    python benchmarks/metric_switches.py SOURCE --song SONG [--clips NAME ...]

SOURCE is a folder as for `dancedata build aist++`. SONG is any music file: AIST's songs may not be redistributed, so
the published table uses another song, and its scores of beat alignment say nothing about the dances. Every line
changes one switch; the first of each table is the reference. docs/reference/protocols.md has them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np

from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24_EDGE
from dancedata.datasets.aistpp import AistPP
from dancedata.evaluation.measuring import in_axes
from dancedata.evaluation.protocol import MotionRule
from dancedata.metrics.beats import DETECTORS, BeatAlignment, BeatDetector
from dancedata.metrics.foot_skating import skating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import pfc
from dancedata.music.signal import load_audio

Clips = Mapping[str, Float64Array]
#: Windows of the comparison of sets, frames at 60 per second, and their distance.
WINDOW, STRIDE = 120, 15
Z_UP = MotionRule("smpl24", None, "z")


def main() -> None:
    """Print the four tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--song", type=Path, required=True)
    parser.add_argument("--clips", nargs="*", help="names of sequences; default: all that have a motion file")
    args = parser.parse_args()
    clips = read_clips(args.source, args.clips)
    print(f"{len(clips)} clips: {', '.join(clips)}\n")
    print_pfc(clips)
    print_beats(clips, args.song)
    print_sets(clips)
    print_skating(clips)


def read_clips(source: Path, names: list[str] | None) -> dict[str, Float64Array]:
    """Return joints (T, 24, 3) at 60 frames per second, with the pelvis of EDGE's kinematics."""
    reader = AistPP(split="all", ignore="none", music="optional")
    refs = [ref for ref in reader.scan(source).clips if not names or ref.id in names]
    return {ref.id: reader.load(ref).joints(SMPL24_EDGE) for ref in refs}


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table in Markdown."""
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print()


def mean(values: list[float]) -> str:
    """Return the mean as text."""
    return f"{np.mean(values):.4g}"


def at_30(clips: Clips) -> dict[str, Float64Array]:
    """Return every second frame."""
    return {name: joints[::2] for name, joints in clips.items()}


def cut(joints: Float64Array, length: int, stride: int) -> list[Float64Array]:
    """Return pieces of a dance."""
    return [joints[start : start + length] for start in range(0, len(joints) - length + 1, stride)]


def print_pfc(clips: Clips) -> None:
    """Print the effect of pieces, rate and axes on PFC."""

    def scores(dances: list[Float64Array], fps: float = 30, up: str = "y") -> list[float]:
        return [pfc(joints, fps, variant="code", up="z" if up == "z" else "y") for joints in dances]

    slow = list(at_30(clips).values())
    rows = [("whole clips", mean(scores(slow)), f"{np.median(scores(slow)):.4g}")]
    for length, stride in ((150, 15), (150, 75), (225, 15)):
        own = [scores(cut(joints, length, stride)) for joints in slow]
        every = [value for values in own for value in values]
        if every:
            name = f"pieces of {length / 30:g} s every {stride / 30:g} s ({len(every)})"
            rows.append((name, mean(every), f"{np.median(every):.4g}"))
    fast = scores(list(clips.values()), 60)
    rows.append(("60 frames per second through the code for 30", mean(fast), f"{np.median(fast):.4g}"))
    tilted = scores([in_axes(joints, Z_UP) for joints in slow])
    rows.append(("y taken as up of z-up data", mean(tilted), f"{np.median(tilted):.4g}"))
    table(("PFC", "mean", "median"), rows)


def print_beats(clips: Clips, song: Path) -> None:
    """Print the effect of detector, direction, kernel and rate on beat alignment."""
    music = beats_of(song)
    rows = []
    for name, metric, fps in beat_switches():
        values = [value for joints in clips.values() if (value := score(metric, joints, fps, music)) is not None]
        rows.append((name, mean([v[0] for v in values]), mean([v[1] for v in values]), f"{len(values)}"))
    table(("BAS, with a foreign song", "mean", "chance level", "clips"), rows)


def beat_switches() -> list[tuple[str, BeatAlignment, int]]:
    """Return name, metric and rate of each line."""
    DETECTORS["unsmoothed"] = BeatDetector("Bailando's without smoothing", "mean")
    DETECTORS["unsmoothed, order 10"] = BeatDetector("Bailando's without smoothing", "mean", order=10)
    frames = {"unit": "frames", "cut": "steps"}
    bailando = BeatAlignment("bailando", "music", 3, **frames)
    return [
        ("bailando at 60", bailando, 60),
        ("from motion to music", BeatAlignment("bailando", "motion", 3, **frames), 60),
        ("no smoothing, order 1", BeatAlignment("unsmoothed", "music", 3, **frames), 60),
        ("no smoothing, order 10", BeatAlignment("unsmoothed, order 10", "music", 3, **frames), 60),
        ("the same frame constants at 30", bailando, 30),
        ("constants in seconds at 30", BeatAlignment("seconds"), 30),
        ("sigma 6 frames", BeatAlignment("bailando", "music", 6, **frames), 60),
        ("fact at 60", BeatAlignment("fact", "motion", 3, unit="frames", cut="frames"), 60),
        ("fact at 30", BeatAlignment("fact", "motion", 3, unit="frames", cut="frames"), 30),
        ("gcd at 30", BeatAlignment("gcd", "motion", 2.12, unit="frames", cut="frames"), 30),
        ("music not cut to the motion", BeatAlignment("bailando", "music", 3, unit="frames", cut="none"), 60),
    ]


def beats_of(song: Path) -> dict[int, MusicBeats]:
    """Return the beats of a song at 60 and at 30 frames per second, by librosa's tracker."""
    signal, feature = load_audio(song), FEATURES.get("librosa35")()
    column = feature.columns.slice("beat").start
    grids = {fps: FrameGrid(Fraction(fps)) for fps in (60, 30)}
    return {
        fps: MusicBeats.of(np.flatnonzero(feature.extract(signal, grid)[:, column]), grid)
        for fps, grid in grids.items()
    }


def score(
    metric: BeatAlignment, joints: Float64Array, fps: int, music: Mapping[int, MusicBeats]
) -> Float64Array | None:
    """Return score and chance level; None without beats."""
    try:
        return metric.measure(Dance(joints[:: 60 // fps], FrameGrid.of(fps), music[fps]))
    except Undefined:
        return None


def print_sets(clips: Clips) -> None:
    """Print the effect of features and statistics on FID and diversity."""
    windows = [window for joints in clips.values() for window in cut(joints, WINDOW, STRIDE)]
    rows = []
    for name, kinetic, geometric, step in set_switches():
        fps = FrameGrid.of(60 // step)
        dances = [Dance(window[::step], fps) for window in windows]
        found = []
        for metric, suffix in ((kinetic, "k"), (geometric, "g")):
            features = np.stack([metric.measure(dance) for dance in dances])
            scores = metric.summarise(features[1::2], features[::2])
            found += [f"{scores[f'fid_{suffix}']:.4g}", f"{scores[f'div_{suffix}']:.4g}"]
        rows.append((name, *found))
    head = f"odd windows of {WINDOW / 60:g} s against even ones ({len(windows)})"
    table((head, "FID_k", "Div_k", "FID_g", "Div_g"), rows)
    print_mixed(windows)


def set_switches() -> list[tuple[str, Kinetic, Geometric, int]]:
    """Return name, metrics, and the step between frames of each line."""
    return [
        ("bailando at 60", Kinetic("code"), Geometric(), 1),
        ("standard deviation by M - 1", Kinetic("code", statistics="torch"), Geometric(statistics="torch"), 1),
        ("absolute positions (fact)", Kinetic("code", "absolute"), Geometric("absolute"), 1),
        ("energy without the slip", Kinetic("fixed"), Geometric(), 1),
        (
            "relative to the root, 22 joints (lodge)",
            Kinetic("code", "root_relative", joints=22),
            Geometric("root_relative", joints=22),
            1,
        ),
        ("30 frames per second", Kinetic("code"), Geometric(), 2),
    ]


def print_mixed(windows: list[Float64Array]) -> None:
    """Print distances of the same motions at two rates, with two origins, and of parts of a pool."""
    fast = [Dance(window, FrameGrid.of(60)) for window in windows]
    slow = [Dance(window[::2], FrameGrid.of(30)) for window in windows]
    kinetic, geometric, absolute = Kinetic("code"), Geometric(), Kinetic("code", "absolute")
    pool = np.stack([kinetic.measure(dance) for dance in fast])

    def distance(metric: Kinetic | Geometric, set_: list[Dance], pool_: Float64Array, name: str) -> str:
        rows = np.stack([metric.measure(dance) for dance in set_])
        return f"{metric.summarise(rows, pool_)[name]:.4g}"

    geometric_pool = np.stack([geometric.measure(dance) for dance in fast])
    rows = [
        ("60 and 30 frames per second, FID_k", distance(kinetic, slow, pool, "fid_k")),
        ("60 and 30 frames per second, FID_g", distance(geometric, slow, geometric_pool, "fid_g")),
        ("positions from the first pelvis and absolute ones, FID_k", distance(absolute, fast, pool, "fid_k")),
    ]
    rng = np.random.default_rng(0)
    for n in (20, 40, 80):
        own = rng.choice(len(windows), min(n, len(windows)), replace=False)
        rows.append(
            (f"{n} of the pool against the pool, FID_k", f"{kinetic.summarise(pool[own], pool)['fid_k']:.4g}")
        )
    table(("the same motions", "distance"), rows)


def print_skating(clips: Clips) -> None:
    """Print the effect of the rule on foot skating."""
    rules: list[tuple[str, str, Callable[[Float64Array], Float64Array]]] = [
        ("lodge-code", "lodge-code", lambda joints: joints),
        ("norm of the step", "lodge-norm", lambda joints: joints),
        ("norm of the speed, 0.3 m/s", "speed", lambda joints: joints),
        ("gmd, floor at the lowest toe", "gmd", floored),
    ]
    rows = []
    for name, rule, prepare in rules:
        values = []
        for joints in at_30(clips).values():
            try:
                values.append(skating(prepare(joints), 30, rule=rule).ratio)
            except Undefined:
                continue
        rows.append((name, mean(values), f"{len(values)}"))
    table(("foot skating at 30", "mean", "clips"), rows)


def floored(joints: Float64Array) -> Float64Array:
    """Move the lowest toe of a dance to the height 0."""
    return np.asarray(joints - (0, joints[:, (10, 11), 1].min(), 0))


if __name__ == "__main__":
    main()
