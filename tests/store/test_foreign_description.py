"""Untrusted datasets: special files are refused at once, unprintable characters are escaped."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dancedata.building.describe import describe_clips, describe_problems, describe_store, store_json
from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.hashing import self_hash
from dancedata.core.tables import json_text
from dancedata.files.regular_file import sha256_file
from dancedata.store import open_store, verify_store
from dancedata.testing.stores import random_fields, write_random_store
from tests import warm
from tests.messages import raises_message

LOUD = "x\x1b[2J\x9b1m\u202e\r\ny"
SAFE = r"x\x1b[2J\x9b1m\u202e\r\ny"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small store to bend."""
    made = write_random_store(
        tmp_path / "store", fields=random_fields({"pose": 3}, {}), clips={"train": 2}, n_frames=(40, 40), length=20,
        quality=[{"clip": "train_c00", "kind": LOUD, "joint": LOUD, "frame": 3, "value": 1.5, "unit": LOUD}],
    )  # fmt: skip
    return made.path


def edit(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change dataset.json, and make the hashes in it right, as an adversary does."""
    document = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    for name in ("stats.json", "rejects.jsonl"):
        document["files"][name]["sha256"] = sha256_file(folder / name)
    change(document)
    document["self_sha256"] = self_hash(document)
    (folder / "dataset.json").write_text(json.dumps(document), encoding="utf-8")


def everything(folder: Path) -> str:
    """All that info and check print."""
    texts = [describe_store(folder), describe_clips(folder), json_text(store_json(folder))]
    return "\n".join([*texts, describe_problems(folder, verify_store(folder))])


@contextmanager
def ended_by_an_alarm(seconds: int = 60) -> Iterator[None]:
    """Raise TimeoutError in what waits for ever."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"it takes more than {seconds} s")

    previous = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


@pytest.mark.parametrize("name", ["dataset.json", "stats.json", "rejects.jsonl"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_no_command_waits_for_special_files(folder: Path, name: str, kind: str) -> None:
    (folder / name).unlink()
    if kind == "pipe":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to("/dev/zero")
    with ended_by_an_alarm():
        problems = describe_problems(folder, verify_store(folder))
        assert "not a regular file" in problems or f"{name}: it is missing" in problems
        if name == "stats.json":  # which info does not show
            describe_store(folder)
            with open_store(folder) as store, raises_message(StoreError, "build", where="store/stats.json"):
                store.scaler("pose")
        else:
            with raises_message(StoreError, "build"):
                describe_store(folder)


def test_commands_end_with_a_message(folder: Path) -> None:
    (folder / "rejects.jsonl").unlink()
    os.mkfifo(folder / "rejects.jsonl")
    for command in ("info", "check"):
        ended = warm.run([sys.executable, "-m", "dancedata", command, str(folder)])
        text = ended.stdout + ended.stderr
        assert ended.returncode == 1, text
        assert "Traceback" not in text
        assert "not a regular file" in text or "rejects.jsonl: it is missing" in text


def test_control_characters_in_a_description(folder: Path) -> None:
    def change(document: dict[str, Any]) -> None:
        document |= {
            "name": LOUD,
            "licence": LOUD,
            "source": {"notes": [LOUD, LOUD * 10_000]},
        }
        document["fields"][0]["axes"] = LOUD
        document["fields"][0]["columns"]["groups"][0]["name"] = LOUD
        document["splits"][LOUD] = document["splits"]["train"]
        document["fps"] = "\n30 "

    rows = [{"reason": LOUD, "clip": LOUD}, {"reason": "nan", "file": "\ud800"}]
    (folder / "rejects.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    edit(folder, change)
    text = everything(folder)
    assert SAFE in text
    assert r"\ud800" in text
    assert all(c.isprintable() or c == "\n" for c in text)
    assert max(map(len, describe_store(folder).split("\n"))) < 3000
    json.loads(json_text(store_json(folder)))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("name", 7), ("licence", ["x"]), ("recipe", []), ("recipe", {"x": "y" * 200_000}), ("source", {"notes": [1]}),
        ("source", {"notes": {}}), ("splits", {"train": {}}), ("splits", {"train": 3}),
        ("splits", {"train": {"clips": 1, "windows": 1, "frames": 1, "songs": 1, "hours": "x"}}),
        ("splits", {"train": {"clips": -1, "windows": 1, "frames": 1, "songs": 1, "hours": 1}}),
        ("splits", {"train": {"clips": 1, "windows": 1, "frames": 1, "songs": 1, "hours": 10**400}}),
        ("versions", "many"), ("source", {"reader": 3}), ("format", [[[[]]] * 1000]),
        ("shards", [{"file": ["x"] * 100_000}]), ("recipe", {"a": json.loads("[" * 200 + "]" * 200)}),
    ],
)  # fmt: skip
def test_values_of_other_types_are_an_error(folder: Path, key: str, value: object) -> None:
    edit(folder, lambda document: document.update({key: value}))
    with pytest.raises(StoreError, match=r"dataset\.json") as error:
        open_store(folder)
    assert len(str(error.value)) < 800
    assert "error" in describe_problems(folder, verify_store(folder))


@pytest.mark.parametrize(
    "line",
    ['{"clip": "x"}', '{"reason": 3}', '{"reason": "nan", "clip": ["x"]}', '{"reason": "nan", "window": "x"}', "[]"],
)
def test_lines_of_other_types_are_an_error(folder: Path, line: str) -> None:
    (folder / "rejects.jsonl").write_text(line + "\n")
    with raises_message(StoreError, "those", where="store/rejects.jsonl") as error:
        describe_store(folder)
    assert len(str(error.value)) < 600


def test_many_lines_are_parsed_in_linear_time(folder: Path) -> None:
    """Each with its own reason."""
    rejects = [{"reason": f"r{k}", "clip": f"c{k}"} for k in range(20_000)]
    (folder / "rejects.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rejects))
    edit(folder, lambda document: None)
    assert describe_store(folder).count("\n    r") >= 8


def test_files_next_to_a_dataset_are_named_without_their_control_characters(folder: Path) -> None:
    (folder / f"{LOUD}~").touch()
    (folder / "dataset.json").rename(folder / "other.json")
    with raises_message(DanceDataError, "finished", where="store") as error:
        open_store(folder)
    assert SAFE in str(error.value)


@pytest.mark.parametrize("rate", ["1000000000000000000000/7", "30/1000000000000000000001"])
def test_rates_that_no_integer_holds_are_an_error(folder: Path, rate: str) -> None:
    edit(folder, lambda document: document["fields"][0].update(rate=rate))
    with raises_message(StoreError, "incomplete", where="store/dataset.json"):
        everything(folder)
