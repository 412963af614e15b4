"""Fuzzes the readers: broken files of all formats, in child processes that may die.

python benchmarks/fuzz/hunt.py release --keep found/     (1,000,000 cases, before a release; goes on with --skip)
python benchmarks/fuzz/hunt.py nightly
python benchmarks/fuzz/hunt.py --target bvh --cases 5000 --seed 7
"""

from __future__ import annotations

import argparse
import atexit
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
#: Runs by name: cases and seed.
RUNS = {"tests": (1_000, 20_260), "nightly": (100_000, 20_261), "release": (1_000_000, 20_262)}
#: Cases of one child process, of bytes changed and of structure: hypothesis keeps what it has drawn in memory.
BATCH, BATCH_STRUCTURED = 5000, 1000
#: Hypothesis makes one case in four.
STRUCTURED_PART = 4
#: A child that waits for something without using the processor is ended after this time, and so much a case more.
WAIT_S, WAIT_A_CASE_S = 120, 2
#: Servers that fork no process at present.
_FREE: list[subprocess.Popen[str]] = []
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1", "PYTHONHASHSEED": "0"}


def run_batch(
    target: str, *, seed: int, first: int, count: int, structured: bool = False, files: Sequence[Path] = ()
) -> dict[str, Any]:
    """Run cases in a child; where it dies, the case is a finding and another child goes on after it."""
    done: dict[str, Any] = {"target": target, "cases": 0, "outcomes": {}, "findings": [], "slowest_s": 0.0}
    done["peak_growth_mb"] = 0.0
    begin, files = first, list(files)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as scratch:
        while count > 0 or files:
            report, finding, n_done = _child(target, Path(scratch), seed, begin, count, structured, files)
            if finding is not None:
                done["findings"].append(finding)
            _add(done, report)
            begin, count, files = begin + n_done, count - n_done, files[n_done:]
            if finding is None:
                break
        for finding in done["findings"]:
            finding["data"] = Path(finding.pop("file")).read_bytes().hex()
    return done


def _child(
    target: str, scratch: Path, seed: int, first: int, count: int, structured: bool, files: Sequence[Path]
) -> tuple[dict[str, Any], dict[str, str] | None, int]:
    """Return the report, a finding if the child died, and how many cases it began."""
    words = [target, str(scratch), "--seed", str(seed), "--first", str(first), "--count", str(count)]
    words += ["--structured"] if structured else []
    words += ["--files", *map(str, files)] if files else []
    (scratch / "progress").write_text("")
    wait_s = WAIT_S + WAIT_A_CASE_S * (count + len(files))
    printed, errors = scratch / "stdout", scratch / "stderr"
    status = _forked(words, wait_s, printed, errors)
    if status == 0:
        report = json.loads(printed.read_text())
        return report, None, int(report["cases"])
    said = errors.read_text(errors="replace")
    if status == -signal.SIGALRM:
        said = f"nothing came within {wait_s} s"
    progress = (scratch / "progress").read_text()
    if not progress:
        raise RuntimeError(f"the child for {target} does not start: {said}")
    known = json.loads(progress)
    case = next(path for path in (scratch / "case").iterdir() if path.name == _file_of(target))
    kept = scratch / "findings" / f"died-{first}-{known['cases']}-{case.name}"
    shutil.copy(case, kept)
    what = {97: "foreign code", -signal.SIGPROF: "more than 1 s"}.get(status, f"died, status {status}")
    report = {**known, "cases": known["cases"] + 1}
    report["outcomes"][f"FINDING {what}"] = report["outcomes"].get(f"FINDING {what}", 0) + 1
    return report, {"what": what, "where": "", "error": said[-600:], "file": str(kept)}, report["cases"]


def _forked(words: list[str], longest_s: int, *files: Path) -> int:
    """Return the exit status of a process of child.py, which a free server forks; a new one if there is none."""
    try:
        server = _FREE.pop()
    except IndexError:
        command = [sys.executable, "-X", "faulthandler", str(HERE / "child.py")]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        server = subprocess.Popen(command, env={**os.environ, **_ENVIRONMENT}, **pipes)
    assert server.stdin is not None
    assert server.stdout is not None
    print(json.dumps([words, longest_s, *map(str, files)]), file=server.stdin, flush=True)
    status = server.stdout.readline()
    if not status:
        return server.wait() or 1
    _FREE.append(server)
    return int(status)


@atexit.register
def _end() -> None:
    for server in _FREE:
        server.communicate()


def _file_of(target: str) -> str:
    sys.path[:0] = [str(HERE), str(HERE.parents[1])]
    from targets import DEFECT, TARGETS

    return TARGETS.get(target, DEFECT).file


def _add(done: dict[str, Any], report: dict[str, Any]) -> None:
    done["cases"] += report["cases"]
    done["outcomes"] = dict(Counter(done["outcomes"]) + Counter(report["outcomes"]))
    done["findings"] += report["findings"]
    for name in ("slowest_s", "peak_growth_mb"):
        done[name] = max(done[name], report.get(name, 0.0))


def hunt(
    cases: int,
    seed: int,
    targets: Sequence[str],
    workers: int,
    skip: int = 0,
    without_structure: Collection[str] | None = None,
) -> list[dict[str, Any]]:
    """Run cases over targets, evenly; returns a report for each target. The first `skip` batches are left out.

    Targets in `without_structure` get changed bytes only: by default those whose structure cannot be drawn.
    """
    if without_structure is None:
        without_structure = WITHOUT_STRUCTURE
    each = -(-cases // len(targets))
    batches = []
    for target in targets:
        of_hypothesis = 0 if target in without_structure else each // STRUCTURED_PART
        for structured, total in ((False, each - of_hypothesis), (True, of_hypothesis)):
            size = BATCH_STRUCTURED if structured else BATCH
            batches += [(target, k, min(size, total - k), structured) for k in range(0, total, size)]
    # All targets get their first cases before any gets its last: a run that is stopped has seen all formats.
    batches.sort(key=lambda batch: batch[1])
    batches = batches[skip:]
    reports = []
    with ThreadPoolExecutor(workers) as pool:
        calls = [
            pool.submit(run_batch, target, seed=seed, first=first, count=count, structured=structured)
            for target, first, count, structured in batches
        ]
        for call in as_completed(calls):
            reports.append(call.result())
            report = reports[-1]
            done = f"{report['target']}: {report['cases']} cases, {len(report['findings'])} findings"
            print(
                done, *sorted({f["what"] + " " + f["where"] for f in report["findings"]}), file=sys.stderr, flush=True
            )
    merged: dict[str, dict[str, Any]] = {}
    for report in reports:
        done = merged.setdefault(report["target"], {**report, "cases": 0, "outcomes": {}, "findings": []})
        _add(done, report)
    return list(merged.values())


#: Compressed audio has no structure that could be drawn.
WITHOUT_STRUCTURE = ("flac", "mp3", "ogg")


def main() -> int:
    """Hunt and print; exit code 1 if anything was found."""
    sys.path[:0] = [str(HERE), str(HERE.parents[1])]
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", nargs="?", choices=RUNS, default="nightly", help="number of cases, and seed")
    parser.add_argument("--cases", type=int, help="instead of the run's")
    parser.add_argument("--seed", type=int, help="instead of the run's")
    parser.add_argument("--target", action="append", choices=TARGETS)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--skip", type=int, default=0, help="batches that an interrupted run printed")
    parser.add_argument("--keep", type=Path, help="folder for what is found")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--list", action="store_true", help="print the targets")
    given = parser.parse_args()
    if given.list:
        print(*TARGETS)
        return 0
    cases, seed = RUNS[given.run]
    cases, seed = given.cases or cases, seed if given.seed is None else given.seed
    reports = hunt(cases, seed, given.target or list(TARGETS), given.workers, given.skip)
    if given.json:
        print(json.dumps(reports))
    else:
        for report in reports:
            shown = {k: v for k, v in report.items() if k != "findings"}
            print(json.dumps(shown))
    seen: set[tuple[str, str]] = set()
    for report in reports:
        for number, finding in enumerate(report["findings"]):
            if given.keep:
                given.keep.mkdir(parents=True, exist_ok=True)
                name = f"{report['target']}-{number:04d}.{finding['what'].split()[0]}"
                (given.keep / name).write_bytes(bytes.fromhex(finding["data"]))
                finding["name"] = name
            if (finding["what"], finding["where"]) not in seen:
                seen.add((finding["what"], finding["where"]))
                said = {k: v for k, v in finding.items() if k != "data"}
                print(f"{report['target']}: {said}", file=sys.stderr)
    n_found = sum(len(r["findings"]) for r in reports)
    slowest, growth = (max(r[name] for r in reports) for name in ("slowest_s", "peak_growth_mb"))
    print(
        f"{sum(r['cases'] for r in reports):,} cases with seed {seed}: {n_found} findings, the slowest case "
        f"{slowest:.3f} s, the largest growth {growth:.1f} MB",
        file=sys.stderr,
    )
    return 1 if seen else 0


if __name__ == "__main__":
    sys.exit(main())
