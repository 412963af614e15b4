"""CLIP_COLUMNS: attributes and free columns of clips come back, or are refused."""

import dataclasses
from fractions import Fraction
from pathlib import Path

import pytest

from dancedata.core.errors import StoreError
from dancedata.store import open_store, write_store
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
from dancedata.testing.stores import write_random_store
from tests.messages import raises_message


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
