"""Builds killed with SIGKILL: the same command resumes, nothing is computed twice, no stray files are left."""

import os
import random
import shutil
import signal
import sys
import time

import pytest

from dancedata.execution.cache_admin import prune
from tests.warm import run

SONG_S = 0.2


@pytest.mark.parametrize("kills", [pytest.param(2), pytest.param(50, marks=pytest.mark.nightly)])
def test_a_build_killed_at_random_moments_gives_the_same_result(slow, corpus, out, undisturbed, hashes, kills):
    """A moment is a while after a number of songs were begun, or the end."""
    slow.sleep(SONG_S)
    chance = random.Random(kills)
    entries: dict[str, int] = {}
    for kill in range(kills):
        before, songs = len(slow.calls()), chance.randint(0, 3)
        process = slow.start(corpus, out, "--jobs", 2, start_new_session=True)
        while process.poll() is None and len(slow.calls()) < before + songs:
            time.sleep(0.01)
        time.sleep(chance.uniform(0, SONG_S))
        if process.poll() is None:
            # Alternately all processes, as in a power failure, and the main one: its workers live on for a moment.
            (os.killpg if kill % 2 else os.kill)(process.pid, signal.SIGKILL)
        if process.wait() == 0:
            assert hashes(out) == undisturbed
            shutil.rmtree(out)
            shutil.rmtree(slow.cache)
            entries = {}
            slow.log("cache removed")
        slow.log(*(f"published {song}" for song in slow.published()))
        assert slow.entries().items() >= entries.items(), "a unit was computed and published again"
        entries = slow.entries()
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.entries().items() >= entries.items()
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    assert slow.strays() == []
    assert computed_after_publishing(slow.log()) == []


def computed_after_publishing(log: list[str]) -> list[str]:
    """Return songs that were computed although they were in the cache."""
    published: set[str] = set()
    wrong = []
    for line in log:
        verb, _, song = line.partition(" ")
        if line == "cache removed":
            published.clear()
        elif verb == "published":
            published.add(song)
        elif song in published:
            wrong.append(song)
    return wrong


#: Runs the command line, and kills it at the n-th time that a file is about to be put in its place, or was.
#: A first try to put it in a folder of the cache that does not exist yet fails, and is not counted.
DYING = """
import os, signal, sys
after, left = sys.argv.pop(1) == "after", int(sys.argv.pop(1))
replace = os.replace
def dying(*args):
    global left
    left -= os.path.isdir(os.path.dirname(args[1]))
    if left == 0 and not after:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(*args)
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
os.replace = dying
from dancedata.cli.app import main
main()
"""


BOTH = [(when, n) for n in range(1, 10) for when in ("before", "after")]


@pytest.mark.parametrize(
    "moments",
    [
        # The first two die while units are published, the others while the dataset is written.
        pytest.param([("after", 6), ("before", 12), ("before", 1), ("after", 8)]),
        pytest.param(BOTH * 2, marks=pytest.mark.nightly),
    ],
    ids=["some", "all"],
)
def test_a_build_killed_while_publishing_resumes(slow, corpus, out, undisturbed, hashes, moments):
    arguments = slow.command(corpus, "--out", out, "--jobs", 1)[3:]
    kills = 0
    for when, n in moments:
        dying = [sys.executable, "-c", DYING, when, str(n), *arguments]
        done = run(dying, slow.environment)
        slow.log(*(f"published {song}" for song in slow.published()))
        if (out / "dataset.json").exists():
            assert hashes(out).items() >= undisturbed.items()
            shutil.rmtree(out)
        kills += done.returncode == -signal.SIGKILL
        assert done.returncode in (0, -signal.SIGKILL), done.stderr
    assert kills == len(moments)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert computed_after_publishing(slow.log()) == []
    assert slow.strays() == []


def test_every_unit_is_computed_once_by_builds_that_run_together(slow, corpus, tmp_path, undisturbed, hashes):
    slow.sleep(0.2)
    outs = [tmp_path / "outs" / str(i) for i in range(2)]
    processes = [slow.start(corpus, out, "--jobs", 1) for out in outs]
    assert [process.wait() for process in processes] == [0, 0]
    assert [hashes(out) for out in outs] == [undisturbed] * 2
    assert len(slow.calls()) == len(set(slow.calls())) == 4
    assert slow.strays() == []


def test_two_builds_into_one_folder(slow, corpus, out, undisturbed, hashes):
    slow.sleep(0.2)
    processes = [slow.start(corpus, out, "--jobs", 1) for _ in range(2)]
    ends = sorted((*process.communicate(), process.returncode) for process in processes)
    assert 0 in [code for *_, code in ends]
    for printed, output, code in ends:
        assert "another build is writing there" in output if code else printed
    assert hashes(out) == undisturbed
    assert [p.name for p in out.parent.iterdir()] == ["out"]


def test_a_build_that_is_stopped_and_woken(slow, corpus, out, undisturbed, hashes):
    """As a job that a scheduler holds: meanwhile another build and pruning take nothing from it."""
    slow.sleep(SONG_S)
    process = slow.start(corpus, out, "--jobs", 2, start_new_session=True)
    while not slow.calls():
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGSTOP)
    assert "another build is writing there" in slow.build(corpus, out, "--jobs", 1, code=1)
    assert prune(slow.cache, max_bytes=0).removed == 0
    os.killpg(process.pid, signal.SIGCONT)
    assert process.wait() == 0, process.communicate()
    assert hashes(out) == undisturbed
    assert sorted(slow.calls()) == sorted(set(slow.calls()))
    assert slow.strays() == []
