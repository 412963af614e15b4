"""Cost of building many clips: wall and CPU time per clip, and the peak memory of every process.

    python benchmarks/build.py                   # 500, 1000 and 2000 clips, whole clips, 2 jobs
    python benchmarks/build.py 2000 --kind slices --jobs 1
    python benchmarks/build.py aistpp            # 1,380 clips of 13.3 s on 60 songs, both kinds

The corpus is synthetic, 40 clips per song, with the fields edge151 and librosa35; it is written before the clock
starts. Clips are short (6 s, 3 windows each), so that fixed costs per clip show; each build starts with an empty
cache.

Memory is read from /proc (Linux): the peak resident set (VmHWM) of the process that builds and of each of its
workers, sampled ten times per second. Pages of libraries and of mapped files that processes share count in each.
"aistpp" has the size of AIST++: split "crossmodal", of which 1,138 clips are stored; times per clip count all 1,380.
Each build is timed with an empty cache, and again from the cache; then the writing of slices alone, see
benchmarks/writing.py. --folder keeps the corpus there for the next time.

`wait4` returns the largest peak of all of them, also between two samples; it is printed as "largest".
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from features import print_machine

CLIPS_PER_SONG = 40
SAMPLE_EVERY_S = 0.1
TRANSFORMS = {"whole": "[]", "slices": "[slices]"}
RECIPE = """recipe: 1
name: benchmark
dataset: {{synthetic: {{songs: {songs}, clips_per_song: {clips}, clip_s: {clip_s}, split: all}}}}
fps: 30
transforms: {transforms}
windows: {{length_s: 5, stride_s: 0.5}}
motion: {{edge151: {{}}}}
audio: {{librosa35: {{}}}}
"""


@dataclass(frozen=True)
class Spent:
    """The cost of a command: seconds, and peak resident memory in MB.

    Attributes
    ----------
    parent_mb, workers_mb
        Of the command itself and of each of its descendants, the largest first.
    largest_mb
        Of the largest of all processes, as the kernel reports it when they have ended.
    """

    wall_s: float
    cpu_s: float
    parent_mb: float
    workers_mb: tuple[float, ...]
    largest_mb: float


def main() -> None:
    """Build corpora of growing size and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", help=f"aistpp, or multiples of {CLIPS_PER_SONG}; others are rounded")
    parser.add_argument("--folder", type=Path, help="for aistpp: folder to work in and to keep the corpus in")
    parser.add_argument("--kind", choices=[*TRANSFORMS], default="whole")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--clip-s", type=float, default=6.0)
    given = parser.parse_args()
    print_machine()
    if given.clips == ["aistpp"]:
        with tempfile.TemporaryDirectory(prefix="build-") as name:
            aistpp(given.folder or Path(name), given.jobs)
        return
    print(f"{given.kind}, {given.jobs} jobs, clips of {given.clip_s:g} s")
    for n_clips in [int(n) for n in given.clips] or (500, 1000, 2000):
        with tempfile.TemporaryDirectory(prefix="build-") as name:
            songs = max(2, round(n_clips / CLIPS_PER_SONG))
            spent = build(Path(name), songs, given.clip_s, given.kind, given.jobs)
        print_row(songs * CLIPS_PER_SONG, spent)


def aistpp(folder: Path, jobs: int) -> None:
    """Build a corpus like AIST++ whole and in slices, cold and from the cache; then measure writing alone."""
    folder.mkdir(parents=True, exist_ok=True)
    print(f"60 songs, 1,380 clips of 13.3 s, {jobs} jobs")
    for kind in ("whole", "slices"):
        recipe, cache = folder / f"{kind}.yaml", folder / f"cache-{kind}"
        text = RECIPE.replace("split: all", "split: crossmodal")
        recipe.write_text(text.format(songs=60, clips=23, clip_s=13.3, transforms=TRANSFORMS[kind]), encoding="utf-8")
        source = folder / "source"
        # Writes the corpus, if it does not exist, and leaves nothing in the cache that is measured.
        environment = {**os.environ, "DANCEDATA_CACHE": str(folder / "cache-plan")}
        command = [sys.executable, "-m", "dancedata"]
        subprocess.run(
            [*command, "build", "--dry-run", str(recipe), str(source)],
            check=True,
            capture_output=True,
            env=environment,
        )
        shutil.rmtree(cache, ignore_errors=True)
        environment["DANCEDATA_CACHE"] = str(cache)
        for label in ("cold", "from the cache"):
            out = folder / "out"
            shutil.rmtree(out, ignore_errors=True)
            arguments = [str(source), "--out", str(out), "--jobs", str(jobs)]
            print(f"{kind}, {label}: ", end="", flush=True)
            print_row(1380, watched([*command, "build", str(recipe), *arguments], environment))
            shutil.rmtree(out)
    print("writing slices (benchmarks/writing.py)", flush=True)
    script = Path(__file__).with_name("writing.py")
    subprocess.run([sys.executable, str(script), *map(str, (recipe, source, cache, folder / "writing"))], check=True)
    shutil.rmtree(folder / "writing")
    for kind in ("whole", "slices", "plan"):
        shutil.rmtree(folder / f"cache-{kind}", ignore_errors=True)


def print_row(n_clips: int, spent: Spent) -> None:
    """Print the cost of a build of `n_clips`."""
    workers = ", ".join(f"{mb:.0f}" for mb in spent.workers_mb)
    print(
        f"{n_clips:>6} clips  wall {spent.wall_s:7.1f} s, {1e3 * spent.wall_s / n_clips:6.1f} ms per clip  "
        f"CPU {spent.cpu_s:7.1f} s, {1e3 * spent.cpu_s / n_clips:6.1f} ms per clip  "
        f"peak MB: parent {spent.parent_mb:.0f}, workers {workers or 'none'}; largest {spent.largest_mb:.0f}  "
        f"(load {os.getloadavg()[0]:.1f})",
        flush=True,
    )


def build(folder: Path, songs: int, clip_s: float, kind: str, jobs: int) -> Spent:
    """Write a corpus, build it with an empty cache from the shell, and return the cost of the build."""
    recipe = folder / "recipe.yaml"
    recipe.write_text(
        RECIPE.format(songs=songs, clips=CLIPS_PER_SONG, clip_s=clip_s, transforms=TRANSFORMS[kind]), encoding="utf-8"
    )
    command = [sys.executable, "-m", "dancedata"]
    source = [str(folder / "source")]
    subprocess.run(
        [*command, "build", "--dry-run", str(recipe), *source], check=True, capture_output=True
    )  # writes the corpus
    environment = {**os.environ, "DANCEDATA_CACHE": str(folder / "cache")}
    out = ["--out", str(folder / "out"), "--jobs", str(jobs)]
    try:
        return watched([*command, "build", str(recipe), *source, *out], environment)
    finally:
        shutil.rmtree(folder / "out", ignore_errors=True)


def watched(command: list[str], environment: dict[str, str]) -> Spent:
    """Run a command and sample the memory of its processes until it ends."""
    begun = time.perf_counter()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    peaks: dict[int, float] = {}
    while True:
        peaks |= {pid: max(mb, peaks.get(pid, 0.0)) for pid, mb in _peaks_mb(process.pid).items()}
        ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        if ended:
            break
        time.sleep(SAMPLE_EVERY_S)
    wall_s = time.perf_counter() - begun
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    parent_mb = peaks.pop(process.pid, 0.0)
    cpu_s = usage.ru_utime + usage.ru_stime
    return Spent(wall_s, cpu_s, parent_mb, tuple(sorted(peaks.values(), reverse=True)), usage.ru_maxrss / 1024)


def _peaks_mb(root: int) -> dict[int, float]:
    """Return the peak resident memory so far of a process and its descendants, by process id."""
    parents, peaks = {}, {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            lines = (entry / "status").read_text(encoding="utf-8").splitlines()
        except OSError:
            continue  # it has ended in the meantime
        status = dict(line.split(":", 1) for line in lines if ":" in line)
        parents[int(entry.name)] = int(status["PPid"])
        # A zombie process has no memory.
        peaks[int(entry.name)] = int(status.get("VmHWM", "0 kB").split()[0]) / 1024
    family = {root}
    while below := {pid for pid, parent in parents.items() if parent in family} - family:
        family |= below
    return {pid: peaks[pid] for pid in family if peaks.get(pid)}


if __name__ == "__main__":
    main()
