"""Readers of foreign files: 1,000 broken files here, 100,000 in the nightly run; what was found once; tables."""

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.store import open_store
from tests.fuzz.conftest import TOOLS, tool

HERE = Path(__file__).resolve().parent
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


CORPUS = Path(__file__).parent / "corpus" / "hdf5"
#: Column and a word of the error, by file.
ERRORS = {
    "a-column-in-another-file": ("windows/start", "not contiguous"),
    "a-compound-of-columns": ("clips/genre", "type"),
    "a-link-to-a-column": ("clips/music", "SoftLink"),
    "a-table-elsewhere": ("clips", "ExternalLink"),
    "a-virtual-column": ("windows/start", "not contiguous"),
    "columns-of-another-length": ("clips/n_frames", "number of rows"),
    "gigabytes-of-ids": ("clips/id", "not contiguous"),
    "lists-in-a-circle": ("clips/lists/values/values", "Group"),
    "negative-frames": ("clips/n_frames", "out of bounds"),
    "no-such-clip": ("windows/clip", "out of bounds"),
    "no-texts-of-utf-8": ("clips/id", "UTF-8"),
    "numbers-for-texts": ("clips/genre", "type"),
    "offsets-below-0": ("clips/lists/offset", "ascend"),
    "offsets-outside-their-values": ("clips/lists/offset", "ascend"),
    "rows-outside-the-shard": ("clips/motion/pose", "outside"),
    "texts-of-variable-length": ("clips/id", "type"),
}


def test_every_file_has_its_error() -> None:
    assert {path.stem for path in CORPUS.iterdir()} == ERRORS.keys()


@pytest.mark.parametrize("name", ERRORS)
def test_errors_name_file_and_column(tmp_path: Path, name: str) -> None:
    files = {**tool("valid_files").store(), "tables.h5": (CORPUS / f"{name}.h5").read_bytes()}
    document = json.loads(files["dataset.json"])
    tables = files["tables.h5"]
    document["files"]["tables.h5"] = {"size": len(tables), "sha256": sha256_bytes(tables)}
    files["dataset.json"] = json.dumps({**document, "self_sha256": self_hash(document)}).encode()
    for file, data in files.items():
        (tmp_path / file).write_bytes(data)
    column, word = ERRORS[name]
    with open_store(tmp_path) as store, pytest.raises(StoreError, match=word) as error:
        list(store.clips())
    assert str(error.value.where) == f"{tmp_path / 'tables.h5'}, /{column}"
