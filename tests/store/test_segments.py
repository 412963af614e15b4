"""Segments in a store: columns of the table, and damage that check names."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dancedata.core.errors import StoreError
from dancedata.core.segments import Layer, Segment
from dancedata.store import open_store, verify_store, write_store
from dancedata.store.schema import SEGMENTS_FILE
from tests.groups_store import HEADER, stored
from tests.store.test_verify import seal

WORDS = Layer("words", language="en", sided="mirrored")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    words = [
        Segment(WORDS, Fraction(0), Fraction(1), "a", ("one", "left"), ("one", "right"), ("one/NUM", "left/ADJ")),
        Segment(WORDS, Fraction(1), Fraction(2), "b", ("same",), ("same",)),
        Segment(WORDS, Fraction(9), Fraction(10), "no frame"),
    ]
    clips = [replace(clip, segments=tuple(words)) for clip in stored({"train": (2,)})]
    write_store(tmp_path, HEADER, clips)
    return tmp_path


def test_equal_mirrored_words_are_not_stored_twice(folder: Path) -> None:
    store = open_store(folder)
    table = store._segment_table
    assert table is not None
    assert list(table.columns["texts_mirrored"]) == [("one", "right"), ()] * 3
    assert [s.texts_mirrored for s in store.segments("train0_p0")] == [("one", "right"), ("same",)]
    assert [(layer["rows"], layer["empty"]) for layer in store.info["layers"]] == [(6, 3)]
    assert verify_store(folder) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table["tokens/offset"].__setitem__(slice(1, None), [1, 2, 3, 4, 5, 6]), "tokens: not as many"),
        (
            lambda table: table["texts_mirrored/offset"].__setitem__(slice(1, None), [3, 3, 4, 4, 6, 6]),
            "mirrored: not as",
        ),
        (lambda table: table["end_s"].__setitem__(0, -5), "end_s: before start_s"),
        (lambda table: table["end"].__setitem__(0, 29), "frames are not those of the times"),
        (lambda table: table["value"].__setitem__(1, np.inf), "value: infinite, in rows 1 (clip alone)"),
    ],
)
def test_damage_is_named(folder: Path, change: Callable[[Any], None], message: str) -> None:
    with h5py.File(folder / SEGMENTS_FILE, "r+") as file:
        change(file["segments"])
    seal(folder)
    problems = verify_store(folder)
    assert message in str(problems[0].message)


@pytest.mark.parametrize(
    ("column", "value"),
    [("end_s", -5), ("end_s", np.inf), ("start_s", np.nan), ("layer", 7), ("layer", -1), ("other", 99), ("other", -2),
     ("clip", 9), ("joint", -2), ("start", -1), ("data", b"[1]"), ("data", b'{"a":NaN}'), ("data", b'{"a":1e999}')],
)  # fmt: skip
def test_a_segment_that_cannot_be_read_is_an_error_of_the_store(folder: Path, column: str, value: Any) -> None:
    with h5py.File(folder / SEGMENTS_FILE, "r+") as file:
        values = file["segments"][column][:]
        if isinstance(value, bytes):  # of another length
            values = values.astype("S16")
            del file["segments"][column]
            file["segments"][column] = values
        file["segments"][column][0] = value
    seal(folder)
    store = open_store(folder)
    with pytest.raises(StoreError, match=rf"segments, row 0|/segments/{column}"):
        store.segments(store.windows("train")[0])
    assert any("/segments" in str(problem) for problem in verify_store(folder))
