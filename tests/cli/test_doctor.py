"""dancedata doctor: a working installation, and what it prints about broken ones."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dancedata.building import commands as api
from dancedata.cli import doctor
from dancedata.cli.doctor import Finding
from dancedata.execution import arithmetic
from tests.commands import as_json, run


def one(findings: Iterator[Finding]) -> Finding:
    (finding,) = findings
    return finding


def test_a_working_installation(tmp_path: Path) -> None:
    """By the command line, with nothing left where it was run, in the temporary folder, and in the cache."""
    folders = {name: tmp_path / name for name in ("tmp", "home", "here")}
    for folder in folders.values():
        folder.mkdir()
    environment = {
        **os.environ,
        "TMPDIR": str(folders["tmp"]),
        "DANCEDATA_CACHE": str(folders["home"] / "cache" / "dancedata"),
    }
    command = [sys.executable, "-m", "dancedata", "doctor", "--json"]
    done = subprocess.run(command, cwd=folders["here"], env=environment, capture_output=True, text=True, check=False)
    about = json.loads(done.stdout)
    assert done.returncode == 0, about
    assert about["ok"]
    found = {check["check"]: check["status"] for check in about["checks"]}
    assert {"Python", "packages", "cache", "music", "workers", "build"} <= set(found)
    assert set(found.values()) <= {"ok", "note"}
    assert [path for folder in folders.values() for path in folder.rglob("*")] == []


@pytest.mark.parametrize("notes", [0, 1, 2])
def test_notes_are_not_a_failure(monkeypatch: pytest.MonkeyPatch, notes: int) -> None:
    findings = [Finding("a", "ok", "b"), *[Finding("c", "note", "d", "e")] * notes]
    monkeypatch.setattr(doctor, "diagnose", lambda: iter(findings))
    lines = run("doctor").stdout.splitlines()
    assert lines[0] == "ok      a: b"
    assert lines[-1] == f"this installation works ({notes} note{'s' * (notes != 1)})"


def test_a_failure_is_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    findings = [Finding("a", "ok", "b"), Finding("c", "failed", "d", "do e")]
    monkeypatch.setattr(doctor, "diagnose", lambda: iter(findings))
    assert run("doctor", code=1).stdout.splitlines()[1:] == ["FAILED  c: d; do e", "1 check failed"]
    assert as_json("doctor", code=1)["checks"][1] == {"check": "c", "status": "failed", "found": "d", "fix": "do e"}


def test_a_check_that_raises_has_failed_and_the_others_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> Iterator[Finding]:
        raise ModuleNotFoundError("No module named 'soxr'", name="soxr")
        yield

    for name in ("check_workers", "check_build"):
        monkeypatch.setattr(doctor, name, lambda: iter([Finding("other", "ok", "ran")]))
    monkeypatch.setattr(doctor, "check_cache", lambda: iter([]))
    monkeypatch.setattr(doctor, "requirements", tuple)
    monkeypatch.setattr(doctor, "check_music", broken)
    *_, music, first, second = doctor.diagnose()
    assert (music.check, music.status, first.check, second.check) == ("music", "failed", "other", "other")
    assert "No module named 'soxr'" in music.found
    assert "constraints.txt" in music.fix


def test_packages_that_are_missing_or_too_old() -> None:
    """One of an extra that is missing is a note; one that dancedata needs, or an old one, has failed."""
    required = [
        "numpy>=99", "no-such-distribution>=1", "pyyaml>=1", 'no-such-distribution; extra == "report"',
        'pyyaml>=99; extra == "smpl"', 'packaging>=1; extra == "dask"',
    ]  # fmt: skip
    findings = {finding.check: finding for finding in doctor.check_packages(required)}
    assert set(findings) == {"Python", "packages", "extra report", "extra smpl", "extra dask"}
    assert findings["packages"].status == "failed"
    problems = f"numpy {np.__version__} is installed, >=99 is needed; no-such-distribution is not installed"
    assert findings["packages"].found == problems
    report = findings["extra report"]
    assert (report.status, report.fix) == ("note", 'pip install "no-such-distribution"')
    assert findings["extra smpl"].status == "failed"
    assert ">=99 is needed" in findings["extra smpl"].found
    assert findings["extra dask"].status == "ok"
    assert [finding.status for finding in doctor.check_packages(["numpy>=2"])] == ["ok", "ok"]
    assert [finding.status for finding in doctor.check_packages([])] == ["ok", "note"]


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "file" / "cache"))
    found = one(doctor.check_cache())
    assert found.status == "failed"
    assert str(tmp_path / "file" / "cache") in found.found
    (tmp_path / "link").symlink_to(tmp_path / "nowhere" / "cache")
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "link"))
    assert one(doctor.check_cache()).status == "failed"
    (tmp_path / "cache" / "features").mkdir(parents=True)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: not str(path).endswith("features"))
    found = one(doctor.check_cache())
    assert (found.status, "cache/features" in found.found) == ("failed", True)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "file" / "cache"))
    found = one(doctor.check_cache())
    assert "set DANCEDATA_CACHE to a writable folder" in found.fix


def test_a_cache_without_space_or_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "new" / "cache"))
    for free, locks, status in [
        (10**12, True, "ok"),
        (10**12, False, "note"),
        (10**9, True, "note"),
        (10, True, "failed"),
    ]:
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path, free=free: SimpleNamespace(free=free))
        with monkeypatch.context() as without:
            if not locks:
                without.setattr("dancedata.files.locks.lock_file", lambda fd, wait: None)
            assert one(doctor.check_cache()).status == status
    assert list(tmp_path.iterdir()) == []


def test_music_without_mp3(monkeypatch: pytest.MonkeyPatch) -> None:
    formats = {"wav": "PCM_16", "mp3": "NO_SUCH_ENCODING"}
    monkeypatch.setattr(doctor, "_FORMATS", formats)
    music = one(doctor.check_music())
    assert music.status == "note"
    assert "writes and reads wav, not mp3" in music.found


def test_a_damaged_dataset(monkeypatch: pytest.MonkeyPatch) -> None:
    def build(*arguments: Any, **options: Any) -> Any:
        built = plain(*arguments, **options)
        shard = next(built.path.glob("*-of-*.h5"))
        shard.write_bytes(shard.read_bytes()[:-1] + b"x")
        return built

    plain = api.build
    monkeypatch.setattr(api, "build", build)
    damaged = one(doctor.check_build())
    assert (damaged.status, "all-00000-of-00001.h5" in damaged.found) == ("failed", True)


def test_workers_that_compute_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    assert one(doctor.check_workers()).status == "ok"
    monkeypatch.setattr(arithmetic, "expected", lambda: "aarch64, openblas NEOVERSEN1")
    other = one(doctor.check_workers())
    assert (other.status, "not aarch64, openblas NEOVERSEN1" in other.found) == ("failed", True)
