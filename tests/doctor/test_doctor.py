"""dancedata doctor: a working installation, and what it prints about broken ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.doctor import diagnosis, machine, packages, sample
from dancedata.doctor.finding import Finding, failed, note, ok
from dancedata.execution import arithmetic


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sample.build_sample(tmp_path_factory.mktemp("doctor"))


def one(findings: Iterator[Finding]) -> Finding:
    (found,) = findings
    return found


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
    assert {"Python", "cache", "processor", "music", "workers", "bytes", "numbers", "reading"} <= set(found)
    assert set(found.values()) <= {"ok", "note"}
    assert [path for folder in folders.values() for path in folder.rglob("*")] == []


@pytest.mark.parametrize(("findings", "code"), [([ok("a", "b")], 0), ([ok("a", "b"), note("c", "d", "e")], 0)])
def test_notes_are_no_failure(monkeypatch: pytest.MonkeyPatch, findings: list[Finding], code: int) -> None:
    monkeypatch.setattr("dancedata.cli.doctor.diagnose", lambda: iter(findings))
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == code
    assert done.stdout.splitlines()[0] == "ok      a: b"
    assert (
        done.stdout.splitlines()[-1]
        == f"this installation works ({len(findings) - 1} note{'s' * (len(findings) != 2)})"
    )


def test_a_failure_is_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.cli.doctor.diagnose", lambda: iter([ok("a", "b"), failed("c", "d", "do e")]))
    done = CliRunner().invoke(app, ["doctor"])
    assert done.exit_code == 1
    assert done.stdout.splitlines()[1:] == ["FAILED  c: d; do e", "1 check failed"]
    as_json = CliRunner().invoke(app, ["doctor", "--json"])
    assert as_json.exit_code == 1
    assert json.loads(as_json.stdout)["checks"][1] == {"check": "c", "status": "failed", "found": "d", "fix": "do e"}


def test_a_check_that_raises_has_failed_and_the_others_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> Iterator[Finding]:
        raise ModuleNotFoundError("No module named 'soxr'", name="soxr")
        yield

    for name in ("_cache", "_processor", "_music", "_workers"):
        monkeypatch.setattr(diagnosis, name, lambda: iter([ok("other", "ran")]))
    monkeypatch.setattr(diagnosis, "requirements", tuple)
    monkeypatch.setattr(diagnosis, "_sample", broken)
    found = list(diagnosis.diagnose())
    assert [f.name for f in found[-5:]] == ["other"] * 4 + ["build"]
    assert found[-1].status == "failed"
    assert "No module named 'soxr'" in found[-1].text
    assert "constraints.txt" in found[-1].fix


def test_a_missing_package_and_one_that_is_too_old() -> None:
    found = one(packages.check_packages(["numpy>=99", "no-such-distribution>=1", "pyyaml>=1"]))
    assert found.status == "failed"
    assert "no-such-distribution is not installed" in found.text
    assert f"numpy {np.__version__} is installed, >=99 is needed" in found.text
    assert "pyyaml" not in found.text
    assert one(packages.check_packages(["numpy>=2", 'no-such-distribution; extra == "dask"'])).status == "ok"
    assert one(packages.check_packages([])).status == "note"


def test_extras() -> None:
    """One that is missing is a note; one that is too old, or cannot be imported, has failed."""
    required = [
        "numpy>=2",
        'no-such-distribution; extra == "report"',
        'pyyaml>=99; extra == "smpl"',
        'packaging>=1; extra == "dask"',
    ]
    found = {f.name: f for f in packages.check_extras(required)}
    assert set(found) == {"extra report", "extra smpl", "extra dask"}
    assert (found["extra report"].status, found["extra report"].fix) == ("note", 'pip install "no-such-distribution"')
    assert found["extra smpl"].status == "failed"
    assert ">=99 is needed" in found["extra smpl"].text
    assert found["extra dask"].status == "ok"


def test_a_package_that_raises_or_crashes_when_it_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "raises_at_import.py").write_text(
        "print('a line of its own')\nraise OSError('libcuda.so is missing')\n"
    )
    (tmp_path / "crashes_at_import.py").write_text("import os\nos.abort()\n")
    (tmp_path / "leaves.py").write_text("import os\nos._exit(0)\n")
    (tmp_path / "noisy.py").write_text("import os\nos.write(1, b'\\xff[')\nraise OSError('no card')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    found = packages.import_problems(["json", "raises_at_import", "crashes_at_import", "base64", "leaves", "noisy"])
    assert found == {
        "raises_at_import": "OSError: libcuda.so is missing",
        "crashes_at_import": "the process that imports it ends with status -6",
        "leaves": "the process that imports it ends with status 0",
        "noisy": "OSError: no card",
    }


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "file" / "cache"))
    found = one(machine.check_cache())
    assert found.status == "failed"
    assert str(tmp_path / "file" / "cache") in found.text
    (tmp_path / "link").symlink_to(tmp_path / "nowhere" / "cache")
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "link"))
    assert one(machine.check_cache()).status == "failed"
    (tmp_path / "cache" / "features").mkdir(parents=True)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(machine.os, "access", lambda path, mode: not str(path).endswith("features"))
    found = one(machine.check_cache())
    assert (found.status, "cache/features" in found.text) == ("failed", True)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "file" / "cache"))
    found = one(machine.check_cache())
    assert "set DANCEDATA_CACHE to a writable folder" in found.fix


def test_a_cache_without_space_or_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "new" / "cache"))
    for free, locks, status in [
        (10**12, True, "ok"),
        (10**12, False, "note"),
        (10**9, True, "note"),
        (10, True, "failed"),
    ]:
        monkeypatch.setattr(machine.shutil, "disk_usage", lambda path, free=free: SimpleNamespace(free=free))
        monkeypatch.setattr(machine, "_locks_work", lambda path, locks=locks: locks)
        assert one(machine.check_cache()).status == status
    assert list(tmp_path.iterdir()) == []


def test_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine._locks_work(tmp_path / "a")
    monkeypatch.setattr(machine, "lock_file", lambda fd, operation: None)  # a file system without locks
    assert not machine._locks_work(tmp_path / "b")


def test_another_processor_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "expected", lambda: "aarch64, openblas NEOVERSEN1")
    monkeypatch.setattr(arithmetic, "has_reference", lambda: False)
    found = one(machine.check_processor())
    assert (found.status, "aarch64, openblas NEOVERSEN1" in found.text) == ("note", True)


def test_music_without_mp3(monkeypatch: pytest.MonkeyPatch) -> None:
    formats = {"wav": "PCM_16", "mp3": "NO_SUCH_ENCODING"}
    monkeypatch.setattr(machine, "_FORMATS", formats)
    music, _ = machine.check_music()
    assert music.status == "note"
    assert "writes and reads wav, not mp3" in music.text


def test_bytes_of_the_reference(dataset: Path) -> None:
    known = sample.reference()
    if dict(known.made_with) != sample.made_with():
        pytest.skip(f"the bytes are known for {known.made_with}, not for {sample.made_with()}")
    assert one(sample.check_bits(dataset, known)).status == "ok"


def test_other_bytes(dataset: Path) -> None:
    known = sample.reference()
    here = replace(known, made_with=sample.made_with(), shards={name: "0" * 64 for name in known.shards})
    found = one(sample.check_bits(dataset, here))
    assert (found.status, "all-00000-of-00001.h5" in found.text) == ("failed", True)
    other = one(sample.check_bits(dataset, replace(known, made_with=sample.made_with() | {"numpy": "1.0"})))
    assert (other.status, f"numpy {np.__version__}, not 1.0" in other.text) == ("note", True)


@pytest.mark.parametrize(
    ("field", "column", "by"), [("edge151", 10, 1e-4), ("librosa35", 3, 0.1), ("librosa35", 34, 1)]
)
def test_other_numbers(dataset: Path, field: str, column: int, by: float) -> None:
    known = sample.reference()
    assert one(sample.check_numbers(dataset, known)).status == "ok"
    rows = known.rows[field].copy()
    rows[5, column] += by
    found = one(sample.check_numbers(dataset, replace(known, rows={**known.rows, field: rows})))
    assert (found.status, f"{field}." in found.text) == ("failed", True)


def test_a_reference_that_covers_every_column() -> None:
    rows = sample.reference().rows
    assert {name: array.shape for name, array in rows.items()} == {"edge151": (24, 151), "librosa35": (24, 35)}
    assert all(np.abs(array).max() > 0 for array in rows.values())


def test_a_damaged_dataset(dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in dataset.iterdir():
        if path.is_file():
            (copy / path.name).write_bytes(path.read_bytes())
    assert one(sample.check_reading(copy)).status == "ok"
    shard = next(copy.glob("*.h5"))
    shard.write_bytes(shard.read_bytes()[:-1] + b"x")
    assert one(sample.check_reading(copy)).status == "failed"


def test_reading_with_torch(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    assert one(sample.check_torch(dataset)).status == "ok"
    monkeypatch.setattr(sample, "_windows", lambda dataset: [])
    assert one(sample.check_torch(dataset)).status == "failed"


def test_two_workers_compute_as_builds_do() -> None:
    assert one(machine.check_workers()).status == "ok"


if __name__ == "__main__":  # writes the reference anew: python tests/doctor/test_doctor.py
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        sample.write_reference(sample.build_sample(Path(name)))
