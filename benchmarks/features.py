"""Speed of librosa35, against the plain loop of librosa calls, one window after another.

    python benchmarks/features.py                # CPU time per window, one core, warm, interleaved
    python benchmarks/features.py --native       # with the kernels that numpy and BLAS choose by themselves
    python benchmarks/features.py --command      # `dancedata build` from the shell, start-up included, 2 jobs

The corpus is synthetic: songs of 14.5 s, most at 48 kHz and stereo, 20 windows of 5 s each. The plain loop does the
same as EDGE's `create_dataset` for every window: load the window's own wav, and librosa for the rest.

- Slices: features of every one by itself. Whole: features of the songs, per window of output.
- CPU time (`time.process_time`), BLAS on one thread, song by song: the versions alternate, in one order and then in
  the other, and ratios are of the times of one song, so that other load on the machine slows both. The median over
  songs is printed with its quartiles. The plain loop computes some windows of each song.
- Kernels of BLAS and numpy are those of builds (x86-64-v3), for both versions. Their cost is the ratio of two runs,
  one with `--native`.
- With `--command`, wall time of the whole command with an empty cache, against the plain loop's wall time in one
  process after its start-up for as many windows as the dataset has; median of the rounds. Two corpora: "demo" is
  that of `dancedata build demo`, where four clips share a song, and so windows of music, which the plain loop
  computes for every clip (AIST++ has 23 clips per song); "distinct" has one clip per song, and no window twice.
  A third, "tiny", of clips with one window, shows the start-up time. Python's compiled files (.pyc) exist, as after
  an installation. As wall time depends on the other load of the machine, the CPU time of all processes is printed,
  too.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from dancedata.execution import arithmetic

if "--native" not in sys.argv:
    arithmetic.adopt()  # before numpy is loaded

import numpy as np
from threadpoolctl import threadpool_limits

from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.store import open_store
from dancedata.synthetic import synthesise_song
from dancedata.synthetic.music import SyntheticSong

GRID = FrameGrid.of(30)
N_ROWS = 150
GENRES = ("BR", "PO", "LO", "MH", "LH", "HO", "WA", "KR", "JS", "JB")
CLIP_S = 13.5
TRANSFORMS = {"whole": "[]", "slices": "[slices]"}
RECIPE = """recipe: 1
name: benchmark
dataset: {dataset}
fps: 30
transforms: {transforms}
windows: {{length_s: 5, stride_s: 0.5}}
motion: {{edge151: {{}}}}
audio: {{librosa35: {{}}}}
"""


def main() -> None:
    """Run the chosen benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--songs", type=int, default=40, help="2 to 60 (default 40)")
    parser.add_argument("--plain-windows", type=int, default=3, help="of each song, by the plain loop (default 3)")
    parser.add_argument("--native", action="store_true", help="kernels that numpy and BLAS choose by themselves")
    parser.add_argument("--command", action="store_true", help="time `dancedata build` from the shell instead")
    parser.add_argument("--rounds", type=int, default=3, help="of --command (default 3)")
    parser.add_argument("--jobs", type=int, default=2, help="of --command (default 2)")
    arguments = parser.parse_args()
    print_machine()
    with threadpool_limits(limits=1):
        if arguments.command:
            time_command(arguments.songs, arguments.rounds, arguments.jobs)
        else:
            time_features(arguments.songs, arguments.plain_windows)


def print_machine() -> None:
    """Print the machine and the versions that the numbers depend on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    packages = ("numpy", "scipy", "librosa", "numba", "soxr", "dancedata")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    print(f"{model}, {os.cpu_count()} CPUs, load {_load()}; Python {platform.python_version()}, {versions}")
    print(f"computing with {arithmetic.here()}")


def _load() -> str:
    """Return the load, a mean of the last minute."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def cpu_s(function: Callable[[], object]) -> float:
    """Return the CPU seconds of a call."""
    start = time.process_time()
    function()
    return time.process_time() - start


def time_features(n_songs: int, n_plain: int) -> None:
    """Time both versions alternately, song by song."""
    songs = [synthesise_song(f"{GENRES[k % 10]}{k // 10 % 6}", length_s=CLIP_S + 1) for k in range(n_songs)]
    _song_times(songs[0], n_plain, False)  # warm: kernels, filter banks, matrices of the window ends
    results = [_song_times(song, n_plain, bool(k % 2)) for k, song in enumerate(songs)]
    n_windows = sum(count for count, _ in results)
    times = {name: [seconds[name] for _, seconds in results] for name in ("plain", "slices", "whole")}
    plain_ms = 1e3 * statistics.median(times["plain"])
    print(f"{n_windows} windows of {n_songs} songs; load {_load()} at the end")
    print(f"plain loop: {plain_ms:.1f} ms per window (CPU, median of songs)")
    for name in ("slices", "whole"):
        ratios = sorted(p / f for p, f in zip(times["plain"], times[name], strict=True))
        low, _, high = statistics.quantiles(ratios, n=4)
        print(
            f"{name}: {1e3 * statistics.median(times[name]):.2f} ms per window of output, "
            f"{statistics.median(ratios):.1f} x the plain loop (quartiles {low:.1f} .. {high:.1f})"
        )


def _song_times(song: SyntheticSong, n_plain: int, plain_first: bool) -> tuple[int, dict[str, float]]:
    """Return a song's number of windows, and CPU seconds per window of output for each version."""
    fast, plain = Librosa35(), Librosa35(method="librosa")
    signal, bpm = song.signal, song.tempo_bpm
    length = 5 * signal.sample_rate
    starts = np.arange(0, signal.n_samples - length + 1, signal.sample_rate // 2)
    chosen = starts[np.linspace(0, len(starts) - 1, n_plain).astype(int)]
    turns: list[tuple[str, int, Callable[[], object]]] = [
        ("plain", n_plain, lambda: plain.extract_windows(signal, chosen, length, GRID, N_ROWS, start_bpm=bpm)),
        ("slices", len(starts), lambda: fast.extract_windows(signal, starts, length, GRID, N_ROWS, start_bpm=bpm)),
        ("whole", len(starts), lambda: fast.extract(signal, GRID, start_bpm=bpm)),
    ]
    ordered = turns if plain_first else turns[::-1]
    return len(starts), {name: cpu_s(function) / count for name, count, function in ordered}


def time_command(n_songs: int, rounds: int, jobs: int) -> None:
    """Time `dancedata build` of the corpora whole and in slices, and the plain loop in one process, alternately."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_corpora(folder, n_songs)
        cases = [(corpus, kind) for corpus in ("demo", "distinct", "tiny") for kind in ("slices", "whole")]
        plain: list[tuple[float, float]] = []
        n_windows: dict[tuple[str, str], int] = {}
        times: dict[tuple[str, str], list[tuple[float, float]]] = {case: [] for case in cases}
        for _ in range(rounds):
            plain.append(_plain_window_s(folder / "distinct"))
            for case in cases:
                times[case].append(_build(folder, *case, jobs))
                with open_store(folder / "out") as store:
                    n_windows[case] = sum(len(store.windows(split)) for split in store.splits)
        wall, cpu = (1e3 * statistics.median(spent) for spent in zip(*plain, strict=True))
        print(f"plain loop, features alone, one process: {wall:.0f} ms per window (CPU {cpu:.0f} ms)")
        for (corpus, kind), spent in times.items():
            n = n_windows[corpus, kind]
            ratio, cpu_ratio = (
                statistics.median(n * p[i] / t[i] for p, t in zip(plain, spent, strict=True)) for i in (0, 1)
            )
            wall, cpu = (statistics.median(s) for s in zip(*spent, strict=True))
            print(
                f"{corpus}, {n} windows, {kind}, whole command, {jobs} jobs: {wall:.2f} s, "
                f"{ratio:.1f} x (CPU of all processes {cpu:.1f} s, {cpu_ratio:.1f} x); load {_load()}"
            )


def _write_corpora(folder: Path, n_songs: int) -> None:
    """Write recipes, and the sources "demo", "distinct", with one clip of each song, and "tiny"."""
    made = {
        "demo": "{seed: 0}",
        "distinct": f"{{songs: {n_songs}, clips_per_song: 2, clip_s: {CLIP_S}}}",
        "tiny": "{songs: 2, clips_per_song: 2, clip_s: 5}",
    }
    for corpus, parameters in made.items():
        recipe = RECIPE.format(dataset=f"{{synthetic: {parameters}}}", transforms=TRANSFORMS["whole"])
        (folder / "made.yaml").write_text(recipe, encoding="utf-8")
        _command(folder, ["build", "--dry-run", str(folder / "made.yaml"), str(folder / corpus)])
    for kind in ("slices", "whole"):
        recipe = RECIPE.format(dataset="aist++", transforms=TRANSFORMS[kind])
        (folder / f"{kind}.yaml").write_text(recipe, encoding="utf-8")
    songs = set()
    for path in sorted((folder / "distinct" / "motions").glob("*.pkl")):
        song = path.stem.split("_")[4]
        if song in songs:
            path.unlink()
        songs.add(song)


def _build(folder: Path, corpus: str, kind: str, jobs: int) -> tuple[float, float]:
    """Return the wall and CPU seconds of a build with an empty cache."""
    for old in ("out", "cache"):
        shutil.rmtree(folder / old, ignore_errors=True)
    command = ["build", str(folder / f"{kind}.yaml"), str(folder / corpus)]
    return _command(folder, [*command, "--out", str(folder / "out"), "--jobs", str(jobs)])


def _command(folder: Path, arguments: list[str]) -> tuple[float, float]:
    """Return the wall and CPU seconds of a command and its descendants."""
    environment = {**os.environ, "DANCEDATA_CACHE": str(folder / "cache")}
    # Compiled files in a separate folder, if the environment forbids them next to the code.
    if environment.pop("PYTHONDONTWRITEBYTECODE", None):
        environment["PYTHONPYCACHEPREFIX"] = str(folder / "pyc")
    start, before = time.perf_counter(), os.times()
    subprocess.run([sys.executable, "-m", "dancedata", *arguments], check=True, env=environment, capture_output=True)
    spent, after = time.perf_counter() - start, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return spent, cpu


def _plain_window_s(source: Path, n_sampled: int = 40) -> tuple[float, float]:
    """Return wall and CPU seconds of the plain loop per window, a mean over windows of all songs, warm."""
    plain = Librosa35(method="librosa")
    from dancedata.music.signal import load_audio  # other benchmarks import this file with an older checkout

    signals = [load_audio(path) for path in sorted((source / "wavs").glob("*.wav"))]
    windows = [(signal, start) for signal in signals for start in _starts(signal)]
    sample = [windows[k] for k in np.linspace(0, len(windows) - 1, n_sampled + 1).astype(int)]
    wall, cpu = [], []
    for signal, start in sample:
        begin, begin_cpu = time.perf_counter(), time.process_time()
        plain.extract_windows(signal, np.array([start]), 5 * signal.sample_rate, GRID, N_ROWS, start_bpm=100.0)
        wall.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - begin_cpu)
    return statistics.mean(wall[1:]), statistics.mean(cpu[1:])


def _starts(signal: AudioSignal) -> list[int]:
    """Return the first samples of the windows of a clip of the corpus."""
    n_windows = int((CLIP_S - 5) / 0.5) + 1
    return [k * signal.sample_rate // 2 for k in range(n_windows)]


if __name__ == "__main__":
    main()
