"""Readers of foreign files: 1,000 broken files here, 100,000 in the nightly run; what was found once stays."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

HERE = Path(__file__).resolve().parent
TOOLS = HERE.parents[1] / "benchmarks" / "fuzz"
#: A child of drawn cases takes seconds to begin with: by default one of each family of formats.
STRUCTURED = ("pickle", "npz", "bvh", "dataset_json", "recipe", "hdf5", "model_pickle")
FOUND = sorted(folder.name for folder in (HERE / "corpus").iterdir())


def findings(reports: list[dict[str, Any]]) -> list[str]:
    return [
        f"{r['target']}: {f['what']} {f['where']} {f['error']}\n{f['data'][:2000]}"
        for r in reports
        for f in r["findings"]
    ]


def targets(hunt: ModuleType) -> list[str]:
    run = subprocess.run(
        [sys.executable, str(TOOLS / "hunt.py"), "--list"], capture_output=True, text=True, check=True
    )
    return run.stdout.split()


def test_broken_files_are_read_or_refused(hunt: ModuleType) -> None:
    names = targets(hunt)
    cases, seed = hunt.RUNS["tests"]
    reports = hunt.hunt(cases, seed, names, workers=2, without_structure=set(names) - set(STRUCTURED))
    assert findings(reports) == []
    assert sum(report["cases"] for report in reports) >= cases
    for report in reports:
        # Cases that are all refused, or all fine, would try nothing.
        # Nearly every change of a dataset.json is one of its structure.
        assert len(report["outcomes"]) > 1 or report["target"] in ("label", "dataset_json"), report


@pytest.mark.parametrize("target", FOUND)
def test_earlier_findings(hunt: ModuleType, target: str) -> None:
    files = sorted((HERE / "corpus" / target).iterdir())
    report = hunt.run_batch(target, seed=0, first=0, count=0, files=files)
    assert findings([report]) == []
    assert report["cases"] == len(files)
    assert "valid" not in report["outcomes"], report["outcomes"]


def test_the_harness_detects_planted_defects(hunt: ModuleType, tmp_path: Path) -> None:
    words = {
        "spins": "more than 1 s",
        "grows": "MemoryError",
        "calls": "foreign code",
        "write": "foreign code",
        "dies!": "died, status -11",
        "index": "IndexError",
    }
    files = [tmp_path / word.strip("!") for word in words]
    for path, word in zip(files, words, strict=True):
        path.write_text(word)
    report = hunt.run_batch("defect", seed=0, first=0, count=0, files=files)
    assert {f["what"] for f in report["findings"]} == set(words.values())
    assert report["cases"] == len(files)
    assert {bytes.fromhex(f["data"]).decode() for f in report["findings"]} == set(words)


@pytest.mark.nightly
def test_a_hundred_thousand_broken_files(hunt: ModuleType) -> None:
    cases, seed = hunt.RUNS["nightly"]
    reports = hunt.hunt(cases, seed, targets(hunt), workers=2)
    assert findings(reports) == []


@pytest.mark.nightly
def test_guided_by_coverage() -> None:
    """With atheris, where it is installed; a process dies of what is found."""
    pytest.importorskip("atheris", reason="atheris is not installed: pip install atheris")
    for target in ("pickle", "npy", "npz", "bvh", "csv", "jsonl", "recipe", "dataset_json"):
        command = [sys.executable, str(TOOLS / "guided.py"), target, "-runs=20000", "-seed=1", "-rss_limit_mb=1000"]
        run = subprocess.run([*command, "-timeout=5"], capture_output=True, text=True, errors="replace")
        assert run.returncode == 0, run.stderr[-2000:]


def test_an_interrupted_run_resumes(hunt: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """The order of batches depends only on the run, so that the number of finished ones determines the rest."""
    run: list[tuple[Any, ...]] = []

    def batch(target: str, **about: Any) -> dict[str, Any]:
        run.append((target, *about.values()))
        return {"target": target, "cases": 1, "outcomes": {}, "findings": [], "slowest_s": 0, "peak_growth_mb": 0}

    monkeypatch.setattr(hunt, "run_batch", batch)
    hunt.hunt(100_000, 1, ["pickle", "bvh", "mp3"], workers=1)
    whole = run.copy()
    run.clear()
    hunt.hunt(100_000, 1, ["pickle", "bvh", "mp3"], workers=1, skip=7)
    assert run == whole[7:]
    assert len(set(whole)) == len(whole)
