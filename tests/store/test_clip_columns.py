"""CLIP_COLUMNS: another attribute of clips is a field of the record and a row of the table, nothing else."""

import dataclasses
import os
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest

import dancedata
from dancedata.core.errors import StoreError
from dancedata.store import open_store, verify_store, write_store
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
from dancedata.testing.stores import write_random_store
from tests.messages import raises_message

FIELD = ("    id: str\n", "    id: str\n    studio: str = ''\n")
ROW = ('    _text("genre", "genre"),\n', '    _text("genre", "genre"),\n    _text("studio", "studio"),\n')

SCRIPT = """
import dataclasses, sys
from pathlib import Path
import dancedata
from dancedata.building.describe import describe_clips
from dancedata.core.errors import StoreError
from dancedata.comparison import diff
from dancedata.store import open_store, verify_store, write_store
from dancedata.testing.stores import write_random_store

folder = Path(sys.argv[1])
made = write_random_store(folder / "plain", clips={"train": 2})

def write(name, studio):
    (folder / name).mkdir()
    clips = [dataclasses.replace(made.clips[0], studio=studio), *made.clips[1:]]
    write_store(folder / name, made.header, clips)
    return folder / name

one, two = write("one", "Tokyo"), write("two", "Osaka")
print("read:", [clip.studio for clip in open_store(one).clips()])
print("check:", verify_store(one))
print("diff:", *map(str, diff(one, two)), sep="|")
print("report:", describe_clips(one).splitlines()[:2])
try:
    write("three", "To\\nkyo")
except StoreError as error:
    print("write:", error)
"""


def test_every_attribute_of_a_record_has_a_column() -> None:
    # The split is an attribute of the tables, free columns have the prefix x/.
    assert {column.name for column in CLIP_COLUMNS} | {"split", "columns"} == {
        f.name for f in dataclasses.fields(ClipRecord)
    }


def test_another_attribute_is_two_entries(tmp_path: Path) -> None:
    shutil.copytree(Path(dancedata.__file__).parent, tmp_path / "dancedata")
    table = tmp_path / "dancedata" / "store" / "clip_columns.py"
    text = table.read_text(encoding="utf-8")
    for old, new in (FIELD, ROW):
        assert text.count(old) == 1
        text = text.replace(old, new)
    table.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)], env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    shown = dict(line.split(":", 1) for line in done.stdout.splitlines() if ":" in line)
    assert shown["read"] == " ['Tokyo', '']"
    assert shown["check"] == " []"
    assert "clips: studio of 1 clip, as 'Tokyo', 'Osaka': train_c00" in shown["diff"]
    assert "studio" in shown["report"]
    assert "Tokyo" in shown["report"]
    assert "studio: an attribute of a clip cannot be stored: a text with a NUL or a line break" in shown["write"]


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


FREE = {"level": (3, 5), "indoors": (True, False), "bpm": (80, 92.5), "tags": (("a", "b"), ()), "beats": ((1, 2), ())}


def test_free_columns_come_back_with_their_types(tmp_path: Path) -> None:
    made = write_random_store(tmp_path / "draft", clips={"train": 2, "test": 1})
    of_clip = [{name: pair[k] for name, pair in FREE.items()} for k in range(2)]
    clips = [dataclasses.replace(c, columns=of_clip[k] if k < 2 else {}) for k, c in enumerate(made.clips)]
    (tmp_path / "store").mkdir()
    write_store(tmp_path / "store", made.header, clips)
    assert verify_store(tmp_path / "store") == []
    with open_store(tmp_path / "store") as store:
        types = store._tables.types
        assert types == {
            "x/level": "int", "x/indoors": "bool", "x/bpm": "float", "x/tags": "texts", "x/beats": "ints",
        }  # fmt: skip
        first, second, third = (store[c.id].columns for c in made.clips)
    assert first == of_clip[0]
    assert second == {name: value for name, value in of_clip[1].items() if value != ()}
    assert third == {}


@pytest.mark.parametrize("values", [("a", 1), (object(),), (("a", 1),)])
def test_free_columns_of_several_types_are_refused(tmp_path: Path, values: tuple[object, ...]) -> None:
    made = write_random_store(tmp_path / "draft", clips={"train": 2})
    clips = [dataclasses.replace(c, columns={"x": values[k % len(values)]}) for k, c in enumerate(made.clips)]
    (tmp_path / "store").mkdir()
    with raises_message(StoreError, "types", where="x/x"):
        write_store(tmp_path / "store", made.header, clips)
