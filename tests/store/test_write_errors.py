"""Errors of the writer, with place and reason."""

import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import Reject
from dancedata.core.errors import StoreError
from dancedata.store import StoredClip, StoreHeader, open_store, verify_store, write_store
from dancedata.store.schema import Field
from dancedata.testing.stores import RandomStore
from tests.messages import raises_message


def audio_of(clip: StoredClip, **change: Any) -> dict[str, Any]:
    return {"audio": {**clip.audio, "music": dataclasses.replace(clip.audio["music"], **change)}}


CLIP_CASES: dict[str, Any] = {
    "nul in id": lambda c: {"id": "a\0"},
    "bad split": lambda c: {"split": "../x"},
    "starts": lambda c: {"starts": (15, 0)},
    "same start": lambda c: {"starts": (0, 0)},
    "negative": lambda c: {"starts": (-1,)},
    "beyond": lambda c: {"starts": (c.n_frames - 29,)},
    "missing field": lambda c: {"motion": {"pose": c.motion["pose"]}},
    "extra field": lambda c: {"audio": {**c.audio, "x": c.audio["music"]}},
    "width": lambda c: {"motion": {**c.motion, "pose": np.zeros((c.n_frames, 6))}},
    "dims": lambda c: {"motion": {**c.motion, "pose": np.zeros(c.n_frames)}},
    "rows": lambda c: {"motion": {**c.motion, "pose": np.zeros((c.n_frames - 1, 7))}},
    "rows 60": lambda c: {"motion": {**c.motion, "fast": np.zeros((c.n_frames, 4))}},
    "offset": lambda c: audio_of(c, offset=-1),
    "short audio": lambda c: audio_of(c, array=np.zeros((29, 5)), key="short"),
    "text": lambda c: {"motion": {**c.motion, "pose": np.full((c.n_frames, 7), "x")}},
}


@pytest.mark.parametrize("case", CLIP_CASES)
def test_clips_that_cannot_be_stored(make_store: Any, out: Path, case: str) -> None:
    made = make_store(clips={"train": 2}, clips_per_song=1)
    bad = dataclasses.replace(made.clips[1], **CLIP_CASES[case](made.clips[1]))
    with raises_message(StoreError, "ascending|attribute|begins|ends|fields|frames|letter|real|wrong"):
        write_store(out, made.header, [made.clips[0], bad])
    assert not any(out.iterdir())


PAIRS: dict[str, tuple[Callable[[StoredClip, StoredClip], dict[str, Any]], str, str]] = {
    "splits that are one file on macOS": (lambda one, two: {"split": "Train"}, "macOS", ""),
    "one id": (lambda one, two: {"id": one.id, "split": "test"}, "share", "train_c00"),
    "one song of two lengths": (
        lambda one, two: audio_of(two, key=one.audio["music"].key, array=np.zeros((999, 5))), "shapes", "music",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "word", "where"), PAIRS.values(), ids=PAIRS)
def test_two_clips_that_cannot_be_stored_together(make_store, out, change, word, where):
    made = make_store(clips={"train": 2}, clips_per_song=1)
    one, two = made.clips
    with raises_message(StoreError, word, where=where):
        write_store(out, made.header, [one, dataclasses.replace(two, **change(one, two))])
    assert not any(out.iterdir())


def test_nothing_to_store(make_store: Any, out: Path) -> None:
    made = make_store(clips={"train": 2})
    empty = [dataclasses.replace(c, starts=()) for c in made.clips]
    for clips in ([], empty):
        with raises_message(StoreError, "rejects"):
            write_store(out, made.header, clips)


HEADER_CASES: list[tuple[dict[str, Any], str]] = [
    ({"length": 0}, "window length"), ({"stride": 0}, "window stride"), ({"fields": ()}, "at least one motion field"),
    ({"meta": {"format": 3}}, "keys that the format uses"), ({"meta": {"x": float("nan")}}, "meta is not valid JSON"),
    ({"meta": {"x": object()}}, "meta is not valid JSON"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), HEADER_CASES)
def test_headers_that_cannot_be_stored(make_store: Any, out: Path, change: dict[str, Any], message: str) -> None:
    made = make_store(clips={"train": 1})
    with pytest.raises(StoreError, match=message):
        write_store(out, dataclasses.replace(made.header, **change), made.clips)
    assert not any(out.iterdir())


@pytest.mark.parametrize(
    "change",
    [{"name": "a/b"}, {"kind": "text"}, {"dtype": "float64"}, {"name": "fast"}, {"rate": Fraction(1, 7)}],
)  # fmt: skip
def test_fields_that_cannot_be_stored(make_store: Any, out: Path, change: dict[str, Any]) -> None:
    made = make_store(clips={"train": 1})
    fields: tuple[Field, ...] = made.header.fields
    header: StoreHeader = dataclasses.replace(
        made.header, fields=(dataclasses.replace(fields[0], **change), *fields[1:])
    )
    with raises_message(StoreError, "letter|pose|share"):
        write_store(out, header, made.clips)


def test_window_between_two_rows(make_store: Any, out: Path) -> None:
    made: RandomStore = make_store(clips={"train": 1}, length=32, stride=16, n_frames=(60, 60))
    slow = dataclasses.replace(made.header.fields[0], name="slow", rate=Fraction(15, 2))
    header = dataclasses.replace(made.header, fields=(*made.header.fields, slow))
    motion = {**made.clips[0].motion, "slow": np.zeros((15, 7))}
    clip = dataclasses.replace(made.clips[0], motion=motion, starts=(0, 14))
    with raises_message(StoreError, "periods", where="clip train_c00, field slow, window 1"):
        write_store(out, header, [clip])


def test_folder_missing_or_taken(make_store: Any, tmp_path: Path) -> None:
    made = make_store(clips={"train": 1})
    with raises_message(StoreError, "exist", where="none"):
        write_store(tmp_path / "none", made.header, made.clips)
    with raises_message(StoreError, "finished", where="store1"):
        write_store(made.path, made.header, made.clips)


def test_failure_half_way_leaves_nothing_that_opens(make_store: Any, out: Path, monkeypatch: Any) -> None:
    made = make_store(clips={"train": 2}, clips_per_song=1, shard_bytes=1)
    seen: list[tuple[int, int]] = []

    def fail(done: int, total: int) -> None:
        seen.append((done, total))
        if done == 2:
            raise OSError(28, "No space left on device")

    with raises_message(StoreError, "writable", where="out"):
        write_store(out, made.header, made.clips, shard_bytes=1, progress=fail)
    assert seen == [(1, 2), (2, 2)]
    assert [p.name for p in out.iterdir()] == ["train-00000-of-00002.h5"]
    with raises_message(StoreError, "finished", where="out"):
        open_store(out)
    write_store(out, made.header, made.clips, shard_bytes=1)
    assert (out / "dataset.json").read_bytes() == (made.path / "dataset.json").read_bytes()


FILL_DISK = """
import resource, signal, sys
from pathlib import Path
from dancedata.core.errors import StoreError
from dancedata.testing.stores import write_random_store

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for limit in (100, 4_000, 20_000, 100_000, 300_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_random_store(Path(sys.argv[1], str(limit)))
    except StoreError as error:
        print(error.problem, [p.name for p in Path(sys.argv[1], str(limit)).iterdir() if "train" in p.name])
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
write_random_store(Path(sys.argv[1], "100"))
"""


def test_full_disk_is_an_error_and_no_crash(tmp_path: Path) -> None:
    # HDF5 itself dies of a segmentation fault when it meets a full disk while closing a file.
    done = subprocess.run(
        [sys.executable, "-B", "-c", FILL_DISK, str(tmp_path)], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["the dataset cannot be written []"] * 5
    assert verify_store(tmp_path / "100") == []


def test_side_files(make_store: Any, out: Path) -> None:
    made = make_store(clips={"train": 1})
    rejects = [Reject("nan", clip="x", detail="line\u2028separator"), Reject("no_music", clip="y"), Reject("nan")]
    quality = [{"clip": made.clips[0].id, "joint": "left_knee", "frame": 3, "value": 1.5}]
    write_store(out, made.header, made.clips, rejects=rejects, quality=quality, card="# Card é\n")
    store = open_store(out)
    assert store.rejects == [json.loads(json.dumps(r.to_json())) for r in rejects]
    assert store.quality == quality
    assert (out / "README.md").read_text(encoding="utf-8") == "# Card é\n"
