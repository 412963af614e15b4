"""CLIP_COLUMNS: another attribute of clips is a field of the record and a row of the table, nothing else."""

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import dancedata
from dancedata.store.clip_columns import CLIP_COLUMNS, COUNT, NAME, NUMBER, TEXT, TEXT_LIST, ClipRecord, ColumnType

FIELD = ("    id: str\n", "    id: str\n    studio: str = ''\n")
ROW = (
    '    ClipColumn("id", NAME, "clip"),\n',
    '    ClipColumn("id", NAME, "clip"),\n    ClipColumn("studio", TEXT, "studio"),\n',
)

SCRIPT = """
import dataclasses, sys
from pathlib import Path
import dancedata, h5py
from dancedata.pipeline.describe import describe_clips
from dancedata.core.errors import StoreError
from dancedata.pipeline.diff import diff
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
print("read:", [clip.studio for clip in open_store(one).clips])
print("check:", verify_store(one))
print("diff:", *map(str, diff(one, two)), sep="|")
print("report:", describe_clips(one).splitlines()[:2])
try:
    write("three", "To\\nkyo")
except StoreError as error:
    print("write:", error)
with h5py.File(next(two.glob("*.h5")), "r+") as file:
    del file["clips/studio"]
from dancedata.store.dataset_json import load_description
from dancedata.store.verify_shard import verify_shard
description = load_description(two)
print("layout:", *verify_shard(next(two.glob("*.h5")), description, description.shards[0])[0])
"""


def test_every_attribute_of_a_record_has_a_column() -> None:
    # The split is an attribute of the shard.
    assert {column.name for column in CLIP_COLUMNS} | {"split"} == {f.name for f in dataclasses.fields(ClipRecord)}


def test_another_attribute_is_two_entries(tmp_path: Path) -> None:
    shutil.copytree(Path(dancedata.__file__).parent, tmp_path / "dancedata")
    table = tmp_path / "dancedata" / "store" / "clip_columns.py"
    text = table.read_text(encoding="utf-8")
    for old, new in (FIELD, ROW):
        assert text.count(old) == 1
        text = text.replace(old, new)
    table.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    shown = dict(line.split(":", 1) for line in done.stdout.splitlines() if ":" in line)
    assert shown["read"] == " ['Tokyo', '']"
    assert shown["check"] == " []"
    assert "clips: studio of 1 clips, as 'Tokyo', 'Osaka': train_c00" in shown["diff"]
    assert "studio" in shown["report"]
    assert "Tokyo" in shown["report"]
    assert "studio: an attribute of a clip cannot be stored: a text with a NUL or a line break" in shown["write"]
    assert "/clips/studio is missing" in shown["layout"]


@pytest.mark.parametrize(
    ("column", "value"),
    [(NAME, "clip é"), (TEXT, ""), (TEXT_LIST, ()), (TEXT_LIST, ("a", "b c")), (NUMBER, None), (NUMBER, 92.5),
     (COUNT, 0), (COUNT, 2**40)],
)  # fmt: skip
def test_values_come_back(column: ColumnType, value: object) -> None:
    assert column.problem(value) == ""
    assert column.decode(column.encode(value)) == value


@pytest.mark.parametrize(
    ("column", "value"),
    [(NAME, ""), (TEXT, "a\0"), (TEXT, "\udcff"), (TEXT, 3), (TEXT_LIST, ("a\nb",)), (TEXT_LIST, ("",)),
     (NUMBER, "92"), (COUNT, -1), (COUNT, 1.5)],
)  # fmt: skip
def test_values_that_cannot_be_stored(column: ColumnType, value: object) -> None:
    assert column.problem(value)
