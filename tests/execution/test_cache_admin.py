"""dancedata cache, its prune and verify, through the command line and through its functions."""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.cli.cache import describe_pruned
from dancedata.core.errors import UsageError
from dancedata.execution import cache_admin
from dancedata.execution.cache import Cache
from dancedata.execution.cache_admin import parse_age, parse_size, prune
from dancedata.files import cache_files
from tests import warm
from tests.commands import as_json
from tests.commands import run as command
from tests.messages import raises_message

HOUR, DAY = 3600.0, 86400.0
#: Blocks of a file system are counted in full.
BIG = 100_000


def run(*args: object, code: int = 0) -> str:
    """Run a command and check its exit code."""
    return str(command(*args, code=code).stdout)


def key(number: int) -> str:
    return f"{number:064x}"


@pytest.fixture
def own(tmp_path: Path) -> Cache:
    """Five entries of 100 kB, the first not used for five days, the last for one; and one of JSON, used now."""
    cache = Cache(tmp_path / "cache")
    for number in range(1, 6):
        path = cache.put_array("features", key(number), np.full(BIG, number, np.uint8)).path
        then = time.time() - (6 - number) * DAY
        os.utime(path, (then, then))
    cache.put_json("files", key(9), "hash")
    return cache


def left(cache: Cache) -> list[int]:
    return [number for number in range(1, 10) if cache.contains("features", key(number))]


def test_info_sums_by_stage(own: Cache):
    about = as_json("cache", "--cache", own.root)
    assert (about["path"], about["entries"]) == (str(own.root), 6)
    features = about["stages"]["features"]
    assert features["entries"] == 5
    assert 5 * BIG <= features["bytes"] <= 6 * BIG
    assert features["days_unused"] == pytest.approx([1, 5], abs=0.01)
    output = run("cache", "--cache", own.root)
    assert "6 entries" in output
    assert "features" in output


def test_an_empty_or_missing_cache_is_not_an_error(tmp_path: Path):
    assert as_json("cache", "--cache", tmp_path / "none")["entries"] == 0
    assert as_json("cache", "prune", "--max-size", "0B", "--cache", tmp_path / "none")["removed"] == 0
    assert as_json("cache", "verify", "--cache", tmp_path / "none")["damaged"] == []
    assert not (tmp_path / "none").exists()


def test_prune_by_size_removes_the_least_recently_used(own: Cache):
    own.array("features", key(1))  # is a use
    found = as_json("cache", "prune", "--max-size", "350kB", "--cache", own.root)
    assert left(own) == [1, 4, 5]
    assert (found["removed"], found["kept"]) == (2, 4)
    assert found["kept_bytes"] <= 350_000


def test_prune_by_age_and_a_dry_run(own: Cache):
    output = run("cache", "prune", "--older-than", "2.5d", "--max-size", "1MB", "--dry-run", "--cache", own.root)
    assert output.startswith("would remove 3 entries")
    assert left(own) == [1, 2, 3, 4, 5]
    assert as_json("cache", "prune", "--older-than", "3.5d", "--cache", own.root)["removed"] == 2
    assert left(own) == [3, 4, 5]


def test_what_links_lead_to_stays(own: Cache):
    outside = (own.root / "features" / "00").rename(own.root.parent / "outside")
    (own.root / "features" / "00").symlink_to(outside)
    prune(own.root, max_bytes=0)
    assert len(list(outside.iterdir())) == 5


def test_mapped_entries_stay(own: Cache):
    found = own.array("features", key(2))
    assert found is not None
    rows = found.mapped()
    old = time.time() - 9 * DAY
    os.utime(found.path, (old, old))
    result = prune(own.root, max_bytes=0)
    assert (left(own), result.in_use) == ([2], 1)
    assert (np.asarray(rows) == 2).all()
    del rows
    assert prune(own.root, max_bytes=0).removed == 1
    assert left(own) == []


def test_entries_of_a_running_build_stay(own: Cache):
    with cache_files.running(own.root):
        own.array("features", key(2))  # as a build that finds it
        result = prune(own.root, max_bytes=0)
    # The entry of JSON was used by now as well.
    assert (left(own), result.in_use) == ([2], 2)
    assert "2 of them because they are in use" in describe_pruned(result, dry=False)
    (own.root / "locks" / f"build-{0:032x}").touch()  # of a build that was killed
    result = prune(own.root, max_bytes=0)
    assert (result.kept, result.swept) == (0, 1)


def test_entries_used_since_they_were_listed_stay(own: Cache, monkeypatch: pytest.MonkeyPatch):
    remove = cache_admin.remove_unused

    def used_meanwhile(path: Path, used: float) -> bool:
        own.array("features", key(1))
        return remove(path, used)

    monkeypatch.setattr(cache_admin, "remove_unused", used_meanwhile)
    assert prune(own.root, older_than_s=3.5 * DAY).removed == 1
    assert left(own) == [1, 3, 4, 5]


@pytest.mark.parametrize("suffix", ["npy", "json"])
def test_verify_finds_damaged_entries(own: Cache, suffix: str):
    assert run("cache", "verify", "--cache", own.root).endswith("6 entries, 0 damaged\n")
    path = sorted(own.root.rglob(f"*.{suffix}"))[0]
    data = bytearray(path.read_bytes())
    data[len(data) * 3 // 4] ^= 1
    path.write_bytes(data)
    found = as_json("cache", "verify", "--cache", own.root, code=1)
    assert [d["path"] for d in found["damaged"]] == [str(path)]
    assert path.exists()
    assert f"removed: {path}" in run("cache", "verify", "--remove", "--cache", own.root, code=1)
    assert not path.exists()
    assert as_json("cache", "verify", "--cache", own.root)["damaged"] == []


#: Runs the command line, and dies instead of the n-th removal of a file.
DYING = """
import os, signal, sys
left, unlink = int(sys.argv.pop(1)), os.unlink
def dying(*args, **options):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return unlink(*args, **options)
os.unlink = dying
from dancedata.cli.app import main
main()
"""


@pytest.mark.parametrize("moment", [1, 2, 3])
@pytest.mark.parametrize("line", ["prune --max-size 0B", "verify --remove"])
def test_killed_while_it_removes(own: Cache, line: str, moment: int):
    """What is left is as it was, and the same command goes on."""
    foreign, wanted = own.root / "features" / "00" / "mine.npy", [2, 4] if "verify" in line else []
    foreign.write_text("somebody's")
    for number in (1, 3, 5):
        with (own.root / "features" / "00" / f"{key(number)}.npy").open("r+b") as file:
            file.seek(BIG // 2)
            file.write(b"damaged")
    words = ["cache", *line.split(), "--cache", str(own.root)]
    before = {path: path.read_bytes() for path in (own.root / "features").rglob("*.npy")}
    done = warm.run([sys.executable, "-c", DYING, str(moment), *words])
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert {path: path.read_bytes() for path in (own.root / "features").rglob("*.npy")}.items() <= before.items()
    assert {*wanted} <= {*left(own)}
    warm.run([sys.executable, "-m", "dancedata", *words])
    assert left(own) == wanted
    assert foreign.read_text() == "somebody's"
    assert list((own.root / "locks").glob("*")) == list((own.root / "tmp").glob("*")) == []


def test_ages_and_sizes():
    assert [parse_age(text) for text in ("90s", "90m", "12h", "1.5d", "2w")] == [90, 5400, 43200, 129600, 1209600]
    assert [parse_size(text) for text in ("0B", "500b", "10k", "1.5MB", "2 GB", "1T")] == [
        0, 500, 10**4, 1_500_000, 2 * 10**9, 10**12,
    ]  # fmt: skip
    for text in ("", "-1", "x", "1y", "inf", "500bb", "9" * 400 + "T"):
        with raises_message(UsageError, "removed"):
            parse_age(text)
        with raises_message(UsageError, "removed"):
            parse_size(text)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], []),
        (["--max-size", "many"], []),
        (["--older-than", "1y"], []),
        (["--older-than", "3"], ["has no unit", "'3'", "30d"]),
        (["--max-size", "50"], ["has no unit", "'50'", "50GB"]),
        (["--max-size", "0"], ["has no unit", "'0'", "50GB"]),
    ],
)
def test_without_a_rule_of_number_and_unit_nothing_is_removed(own: Cache, options: list[str], words: list[str]):
    result = CliRunner().invoke(app, ["cache", "prune", *options, "--cache", str(own.root)])
    assert result.exit_code == 2, result.output
    assert [word for word in words if word not in result.stderr] == []
    assert left(own) == [1, 2, 3, 4, 5]
