"""Speed of dancedata.metrics, against plain loops of the same formulas.

    python benchmarks/metrics.py              # CPU time per clip and ratios, one core, warm
    python benchmarks/metrics.py --set        # 1,408 clips of 13.5 s, 60 per second: all metrics of a protocol

The loops (`metric_loops.py`) go frame by frame and joint by joint, as the published programs do, with numpy for
vectors of three; `scipy.linalg.sqrtm` for the Frechet distance. Dances are synthetic, 13.5 s at 60 frames per second,
24 joints.

- CPU time (`time.process_time`), BLAS on one thread, clip by clip: the two versions alternate, in one order and then
  in the other, and ratios are of the times of one clip. The median over clips is printed with its quartiles.
- With `--set`, one process computes kinetic and geometric features, beats and beat alignment, PFC and skating of
  every clip, then Frechet distances and diversities of 40 clips against all. Beats of the music are given. Joint
  positions are made before; the clips are 46 dances, each delayed, scaled and with noise.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable

import metric_loops as loops
import numpy as np
from threadpoolctl import threadpool_limits

from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.metrics import beat_alignment, diversity, frechet, geometric, kinetic, motion_beats, pfc, skating
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.key_motion import smoothed
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc
from dancedata.synthetic import synthesise_motion

GRID = FrameGrid.of(60)
N_FRAMES = 810
N_CLIPS, N_SET = 1408, 40
BEATS = list(range(14, N_FRAMES, 31))
GENRES = ("BR", "PO", "LO", "MH", "LH", "HO", "WA", "KR", "JS", "JB")
PROTOCOL: tuple[Metric, ...] = (
    Kinetic("code"),
    Geometric(),
    BeatAlignment("bailando", "music", 3.0, "frames", "steps"),
    Pfc("code"),
    FootSkating("lodge-code"),
)


def main() -> None:
    """Run the chosen benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=5, help="of the comparison with loops (default 5)")
    parser.add_argument("--set", action="store_true", help="measure 1,408 clips instead")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    with threadpool_limits(limits=1):
        if arguments.set:
            measure_set()
        else:
            compare(arguments.clips)


def dances(n: int) -> list[Float64Array]:
    """Return joint positions (T, 24, 3) of n synthetic dances."""
    names = [f"g{GENRES[k % 10]}_sBM_cAll_d{k:02d}_m{GENRES[k % 10]}{k % 6}_ch{k % 10 + 1:02d}" for k in range(n)]
    return [synthesise_motion(name, n_frames=N_FRAMES)[0].joints() for name in names]


def compare(n_clips: int) -> None:
    """Print CPU time per clip of both versions and the ratios."""
    clips = dances(n_clips)
    rng = np.random.default_rng(0)
    features = [(rng.normal(size=(40, 72)), rng.normal(size=(400, 72))) for _ in clips]

    def smooth(curve: Float64Array) -> Float64Array:
        return smoothed(curve, 5)

    rows: dict[str, tuple[Callable[[int], object], Callable[[int], object]]] = {
        "kinetic": (
            lambda k: kinetic(clips[k], 60, energy="code"),
            lambda k: loops.kinetic(clips[k], 1 / 60, slip=True),
        ),
        "geometric": (lambda k: geometric(clips[k]), lambda k: loops.geometric(clips[k])),
        "motion beats": (
            lambda k: motion_beats(clips[k], 60, detector="bailando"),
            lambda k: loops.motion_beats(clips[k], smooth),
        ),
        "beat alignment": (
            lambda k: beat_alignment(np.array(BEATS), np.array(BEATS) + 3, sigma=3),
            lambda k: loops.beat_alignment(BEATS, [beat + 3 for beat in BEATS], 3),
        ),
        "PFC": (lambda k: pfc(clips[k], 30), lambda k: loops.pfc(clips[k])),
        "skating": (
            lambda k: skating(clips[k], 30, rule="lodge-code").ratios,
            lambda k: loops.skating(clips[k]),
        ),
        "Frechet, 40 against 400": (lambda k: frechet(*features[k]), lambda k: loops.frechet(*features[k])),
        "diversity of 400": (lambda k: diversity(features[k][1]), lambda k: loops.diversity(features[k][1])),
    }
    print(f"{'':26}{'ms':>9}{'loop ms':>10}{'ratio':>8}   quartiles")
    for name, (ours, loop) in rows.items():
        ours(0)
        times = [_both(ours, loop, k) for k in range(n_clips)]
        ratios = [slow / fast for fast, slow in times]
        fast, slow = (1e3 * statistics.median(column) for column in zip(*times, strict=True))
        low, high = np.quantile(ratios, [0.25, 0.75])
        print(f"{name:26}{fast:9.3f}{slow:10.2f}{statistics.median(ratios):8.0f}   {low:.0f} .. {high:.0f}")


def _both(ours: Callable[[int], object], loop: Callable[[int], object], k: int) -> tuple[float, float]:
    calls = [(ours, 20), (loop, 1)]
    found = {}
    for call, repeats in calls if k % 2 else calls[::-1]:
        start = time.process_time()
        for _ in range(repeats):
            call(k)
        found[call] = (time.process_time() - start) / repeats
    return found[ours], found[loop]


def measure_set() -> None:
    """Print the CPU time of all metrics of a protocol over a set as large as AIST++."""
    base = dances(46)
    rng = np.random.default_rng(0)
    music = MusicBeats.of(BEATS, GRID)
    spent = dict.fromkeys((metric.name for metric in PROTOCOL), 0.0)
    rows: dict[str, list[Float64Array]] = {name: [] for name in spent}
    start = time.process_time()
    prepared = 0.0
    for k in range(N_CLIPS):
        before = time.process_time()
        joints = np.roll(base[k % len(base)], int(rng.integers(N_FRAMES)), axis=0) * rng.normal(1, 0.05)
        joints = joints + rng.normal(0, 0.001, joints.shape)
        prepared += time.process_time() - before
        dance = Dance(joints, GRID, music)
        for metric in PROTOCOL:
            before = time.process_time()
            try:
                rows[metric.name].append(metric.measure(dance))
            except Undefined as outcome:
                print(f"clip {k}: {outcome}")
            spent[metric.name] += time.process_time() - before
    for metric in PROTOCOL:
        before = time.process_time()
        table = np.array(rows[metric.name])
        metric.summarise(table[:N_SET] if metric.needs_pool else table, table)
        spent[metric.name] += time.process_time() - before
    for name, seconds in spent.items():
        print(f"{name:20}{seconds:8.2f} s{1e3 * seconds / N_CLIPS:9.2f} ms per clip")
    print(f"{'all':20}{time.process_time() - start - prepared:8.2f} s for {N_CLIPS:,} clips of {N_FRAMES / 60:g} s")


if __name__ == "__main__":
    main()
