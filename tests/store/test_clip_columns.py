"""Attributes, free columns and segments of clips come back, or are refused; damage of segments is named."""

import dataclasses
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
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
from dancedata.store.schema import SEGMENTS_FILE
from dancedata.testing.stores import write_random_store
from tests.groups_store import HEADER, stored
from tests.messages import raises_message
from tests.store.test_verify import seal


def test_every_attribute_of_a_record_has_a_column() -> None:
    # The split is an attribute of the tables, free columns have the prefix x/.
    assert {column.name for column in CLIP_COLUMNS} | {"split", "columns"} == {
        f.name for f in dataclasses.fields(ClipRecord)
    }


COLUMNS = {column.name: column for column in CLIP_COLUMNS}


@pytest.mark.parametrize(
    ("column", "value"),
    [("id", "clip é"), ("genre", ""), ("lists", ()), ("lists", ("a", "b c")), ("tempo_bpm", None),
     ("tempo_bpm", 92.5), ("n_flags", 0), ("n_flags", 2**31 - 1), ("audio_start", Fraction(-1, 3)),
     ("source_end", None),
     ("made_of", "0123456789ab" * 3), ("made_of", ""), ("member", -1)],
)  # fmt: skip
def test_values_come_back(tmp_path: Path, column: str, value: object) -> None:
    made = write_random_store(tmp_path / "draft", clips={"train": 2})
    clips = [dataclasses.replace(made.clips[0], **{column: value}), *made.clips[1:]]
    (tmp_path / "store").mkdir()
    write_store(tmp_path / "store", made.header, clips)
    with open_store(tmp_path / "store") as store:
        assert value in [getattr(clip, column) for clip in store]


@pytest.mark.parametrize(
    ("column", "value"),
    [("id", ""), ("genre", "a\0"), ("genre", "\udcff"), ("genre", 3), ("lists", ("a\nb",)), ("lists", ("",)),
     ("lists", "ab"), ("tempo_bpm", "92"), ("n_flags", -1), ("n_flags", 1.5), ("n_flags", 2**31), ("n_frames", 0),
     ("audio_start", 0.5), ("made_of", "xyz"), ("member", "1")],
)  # fmt: skip
def test_values_that_cannot_be_stored(column: str, value: object) -> None:
    assert COLUMNS[column].problem(value)


@pytest.mark.parametrize("values", [("a", 1), (object(),), (("a", 1),)])
def test_free_columns_of_several_types_are_refused(tmp_path: Path, values: tuple[object, ...]) -> None:
    made = write_random_store(tmp_path / "draft", clips={"train": 2})
    clips = [dataclasses.replace(c, columns={"x": values[k % len(values)]}) for k, c in enumerate(made.clips)]
    (tmp_path / "store").mkdir()
    with raises_message(StoreError, "types", where="x/x"):
        write_store(tmp_path / "store", made.header, clips)


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
        (lambda table: table["first"].__setitem__(0, 1), "do not ascend from 0 to the last"),
        (lambda table: table["first"].__setitem__(1, 99), "do not ascend from 0 to the last"),
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
