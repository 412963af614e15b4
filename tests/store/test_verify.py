"""verify_store finds what can be wrong with a dataset."""

import dataclasses
import json
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dancedata.core.codebook import Codebook
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256
from dancedata.files.regular_file import sha256_file
from dancedata.store import Signal, open_store, verify_store, write_store
from dancedata.store.schema import Field
from dancedata.testing.stores import random_fields, write_random_store
from tests.groups_store import HEADER, stored
from tests.messages import raises_message

TRAIN = "train-00000-of-00001.h5"
TABLES = "tables.h5"


def seal(folder: Path) -> None:
    """Make sizes and hashes right again after a change, so that only deeper defects are left to find."""
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    named = [(e, e["file"]) for e in info["shards"]] + [(e, n) for n, e in info["files"].items()]
    for entry, name in named:
        if (folder / name).is_file():
            entry.update(size=(folder / name).stat().st_size, sha256=sha256_file(folder / name))
    info.pop("self_sha256", None)
    path.write_text(json.dumps({**info, "self_sha256": json_sha256(info)}))


def change_json(folder: Path, change: Callable[[dict[str, Any]], None], *, hide: bool = True) -> None:
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    change(info)
    path.write_text(json.dumps(info))
    if hide:
        seal(folder)


def edit(folder: Path, dataset: str, index: Any, value: Any, shard: str = TRAIN) -> None:
    """Change values of a shard, or of a table, and hide it from the hashes."""
    with h5py.File(folder / shard, "r+", locking=False) as file:
        file[dataset][index] = value
    seal(folder)


def only_error(folder: Path) -> str:
    [problem] = [p for p in verify_store(folder) if p.severity == "error"]
    return str(problem)


def test_sound_dataset_has_no_problems(make_store: Any) -> None:
    assert verify_store(make_store(shard_bytes=9000).path) == []
    assert verify_store(make_store(clips={"test": 1}).path) == []


def test_flipped_bit_anywhere(make_store: Any) -> None:
    made = make_store()
    for path in sorted(made.path.iterdir()):
        data = bytearray(path.read_bytes())
        for place in {0, len(data) // 2, len(data) - 1} if data else set():
            changed = bytearray(data)
            changed[place] ^= 1
            path.write_bytes(changed)
            problems = verify_store(made.path)
            assert problems, (path, place)
            assert path.name in problems[0].where, (path, place)
        path.write_bytes(data)
    assert verify_store(made.path) == []


def test_missing_files(make_store: Any) -> None:
    for name in (TRAIN, TABLES, "stats.json", "rejects.jsonl"):
        made = make_store()
        (made.path / name).unlink()
        assert name in only_error(made.path)
        assert "missing" in only_error(made.path)
    made = make_store()
    (made.path / "dataset.json").unlink()
    assert "no finished dataset" in only_error(made.path)
    assert "no such folder" in only_error(made.path / "nowhere")


def test_changed_card_is_a_note(make_store: Any) -> None:
    made = make_store()
    (made.path / "README.md").write_text("my own words")
    [problem] = verify_store(made.path)
    assert problem.severity == "note"
    assert problem.where.endswith("README.md")
    assert problem.to_json() == {"severity": "note", "where": problem.where, "message": problem.message}


def test_a_stride_that_no_windows_have_is_a_note(make_store: Any) -> None:
    made = make_store()
    change_json(made.path, lambda d: d["windows"].update(stride=1))
    [problem] = verify_store(made.path)
    assert (problem.severity, "stride is 1" in problem.message) == ("note", True)


#: A change of a dataset, whose hashes are made right again.
Change = Callable[[Path], None]


def described(change: Callable[[dict[str, Any]], Any]) -> Change:
    return lambda folder: change_json(folder, change, hide=False)


def values(dataset: str, index: int, value: Any) -> Change:
    return lambda folder: edit(folder, dataset, index, value, TABLES)


def layout(dataset: str, change: Callable[[Any], Any], **options: str) -> Change:
    """Put something else in the place of a dataset."""

    def changed(folder: Path) -> None:
        name = TRAIN if dataset.startswith("motion") else TABLES
        with h5py.File(folder / name, "r+", locking=False) as file:
            new = change(file[dataset][...])
            del file[dataset]
            if new is not None:
                file.create_dataset(dataset, data=new, **options)

    return changed


def attribute(name: str, path: str, key: str, value: Any) -> Change:
    """Change what readers that have HDF5 alone take rows by."""

    def changed(folder: Path) -> None:
        with h5py.File(folder / name, "r+", locking=False) as file:
            file[path].attrs[key] = value

    return changed


DAMAGE: list[tuple[Change, str]] = [
    (described(lambda d: d.update(format=7)), "another format version"),
    (described(lambda d: d.pop("fields")), "KeyError: 'fields'"),
    (described(lambda d: d.update(fps="0")), "dataset.json is incomplete"),
    (described(lambda d: d["windows"].update(length="30")), "not a whole number"),
    (described(lambda d: d["shards"][0].update(file="../x-00000-of-00001.h5")), "not the name of a shard"),
    (described(lambda d: d["splits"]["train"].update(clips=5)), "splits: train has 6 clips, not 5"),
    (described(lambda d: d["splits"]["val"].update(songs=9)), "splits: val has 1 songs, not 9"),
    (described(lambda d: d["splits"]["test"].update(hours=0.5)), "hours, not 0.5"),
    (described(lambda d: d["splits"].pop("val")), "splits are not those of the shards"),
    (described(lambda d: d["fields"][0].update(name="other")), "does not state the rows of every field"),
    (described(lambda d: d["files"].pop("tables.h5")), "does not list tables.h5"),
    (described(lambda d: d["shards"].append(d["shards"][0])), "neighbours"),
    (described(lambda d: d["shards"][0].update(windows=3)), "another number of rows"),
    (described(lambda d: d["shards"][0].update(clips=3)), "another number of rows"),
    (described(lambda d: d["shards"][1].update(split="dev")), "/clips/split: not that of the clip"),
    (described(lambda d: d["shards"][0]["fields"]["pose"].__setitem__(0, 64)), "rows from byte 64 on"),
    (described(lambda d: d["shards"][0]["fields"]["pose"].__setitem__(1, 9)), "allowed: 9 rows from byte"),
    (described(lambda d: d["fields"][0].update(rate="60")), "/windows: rows of pose"),
    (described(lambda d: d["fields"][0].update(dtype="float16")), "the shape or dtype of a field differs"),
    (values("windows/clip", 0, 99), "/windows/clip: a number is out of bounds"),
    (values("windows/start", 0, -1), "outside their clip"),
    (values("windows/start", 0, 10**6), "outside their clip"),
    (values("windows/start", 1, 0), "/windows: not by clip and start"),
    (values("clips/n_frames", 0, 0), "not a whole number from 1"),
    (values("clips/n_frames", 0, 31), "rows and frames do not match, in rows 0 (clip train_c00)"),
    (values("clips/n_flags", 0, -1), "/clips/n_flags of clip"),
    (values("clips/id", 0, b"\xff"), "/clips/id: a text that is not valid UTF-8"),
    (values("clips/id", -1, b"train_c00"), "clip train_c00 occurs 2 times, in test, train"),
    (values("clips/music", 0, b"a\0b"), "/clips/music of clip 'train_c00': a text with a NUL"),
    (
        values("clips/file", 0, b"val-00000-of-00001.h5"),
        "/clips/file: not that of the clip in dataset.json, in rows 0",
    ),
    (values("clips/lists/offset", 1, 99), "/clips/lists/offset: offsets that do not ascend within the values"),
    (values("clips/motion/pose/start", 1, 0), "do not follow one another"),
    (values("clips/motion/fast/length", 0, 10**7), "spans outside"),
    (values("clips/audio/music/length", 0, 10**7), "spans outside"),
    (values("clips/audio/layer/offset", 0, -2), "/windows: rows of layer"),
    (layout("motion/pose", lambda old: np.tile(old, (2, 1))), "not a multiple of 64"),
    (layout("motion/pose", lambda old: old[:, :-1]), "the shape or dtype of a field differs"),
    (layout("motion/pose", lambda old: old, compression="gzip"), "a dataset is not contiguous"),
    (layout("motion/pose", lambda old: old.astype(">f4")), "the shape or dtype of a field differs"),
    (layout("windows/start", lambda old: None), "a dataset is missing"),
    (layout("clips/lists/values", lambda old: old[1:]), "offsets do not begin at 0 and end at the last entry"),
    (layout("clips/genre", lambda old: np.arange(len(old))), "/clips/genre: a column of a table"),
    (attribute(TRAIN, "/", "format", 1), "attribute format is"),
    (attribute(TRAIN, "/", "split", np.bytes_("test")), "attribute split is"),
    (attribute(TRAIN, "motion/pose", "rate", np.bytes_("999")), "attribute rate is"),
    (attribute(TABLES, "/", "fps", np.bytes_("60")), "attribute fps is"),
    (attribute(TABLES, "/", "fps", "30"), "attribute fps is"),
    (attribute(TABLES, "windows", "length", 7), "attribute length is"),
    (lambda folder: edit(folder, "motion/pose", (41, 2), np.nan), "1 values are not finite, first row 41"),
    (lambda folder: edit(folder, "audio/layer", (41, 2), np.inf), "1 values are not finite, first row 41"),
    (lambda folder: bool((folder / TRAIN).write_bytes(b"not HDF5")) or None, "cannot be read"),
]


@pytest.mark.parametrize(("change", "message"), DAMAGE)
def test_damage_is_named(make_store: Any, change: Change, message: str) -> None:
    folder = make_store().path
    change(folder)
    seal(folder)
    problems = verify_store(folder)
    assert any(message in str(p) for p in problems), problems


def test_changed_dataset_json(make_store: Any) -> None:
    made = make_store()
    change_json(made.path, lambda d: d.update(licence="MIT"), hide=False)
    assert "self_sha256" in only_error(made.path)


def errors_after(folder: Path, dataset: str, index: Any, value: Any) -> str:
    edit(folder, dataset, index, value, TABLES)
    return " ".join(str(p) for p in verify_store(folder) if p.severity == "error")


@pytest.mark.parametrize("field", ["pose", "layer"])
@pytest.mark.parametrize(
    ("name", "value"), [("max", 99.0), ("min", None), ("mean", 0.5), ("n", 3), ("scaler", {"data_min": [0.0] * 7})]
)
def test_numbers_of_stats_are_those_of_the_rows(make_store: Any, field: str, name: str, value: Any) -> None:
    """Of rows that clips share only what does not depend on how often they count."""
    made = make_store()
    stats = json.loads((made.path / "stats.json").read_text())
    numbers = stats["fields"][field]
    numbers[name] = [value, *numbers[name][1:]] if isinstance(value, float) else value
    (made.path / "stats.json").write_text(json.dumps(stats))
    seal(made.path)
    if field == "layer" and name in ("mean", "n"):
        assert verify_store(made.path) == []
    else:
        assert f"{field}: not the {name} of the rows" in only_error(made.path)


#: Of one clip of 90 frames with windows of 30 frames at 0, 20, 40 and 60: column, row, value and its error.
WINDOW_CASES: list[tuple[str, int, int, str]] = [
    ("windows/start", 3, 60, ""),
    ("windows/start", 3, 61, "/windows: outside their clip"),
    ("windows/start", 3, 61, "/windows: rows of pose are outside the field"),
    ("clips/motion/pose/length", 0, 89, "do not fill the"),
]  # fmt: skip


@pytest.mark.parametrize(("dataset", "index", "value", "message"), WINDOW_CASES)
def test_windows_lie_in_their_clip(make_store: Any, dataset: str, index: int, value: int, message: str) -> None:
    made = make_store(clips={"train": 1}, n_frames=(90, 90), length=30, stride=20)
    found = errors_after(made.path, dataset, index, value)
    assert message in found if message else found == ""


CODES = Field(
    "codes", "motion", Columns((Group("code", 2, "1"),), None), Fraction(30), "int16", Codebook("body", (4, 7))
)


def write_codes(make_store: Any, out: Path, field: Field) -> None:
    made = make_store(clips={"train": 2}, n_frames=(60, 60), length=30, stride=20)
    rows = np.array([[0, 0], [3, 6], [-1, -1]] * 20, dtype=np.int16)
    clips = [dataclasses.replace(clip, motion={"codes": rows}, audio={}) for clip in made.clips]
    write_store(out, dataclasses.replace(made.header, fields=(field,)), clips)


def test_codes_are_those_of_their_codebook(make_store: Any, out: Path) -> None:
    write_codes(make_store, out, CODES)
    assert verify_store(out) == []
    for row, column, value in ((60, 0, 4), (61, 1, 7), (119, 1, -2)):
        edit(out, "motion/codes", (row, column), value)
        assert f"1 values are not codes of their codebook, first row {row} (clip train_c01)" in only_error(out)
        edit(out, "motion/codes", (row, column), 0)


BAD_BOOKS: dict[str, dict[str, Any]] = {
    "levels": {"sizes": [4]}, "no codes": {"sizes": [4, 0]}, "pad": {"pad": 70_000}, "pad of a code": {"pad": 3},
    "size": {"sizes": [4, 70_000]},
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_BOOKS)
def test_codebooks_that_do_not_fit(make_store: Any, out: Path, case: str) -> None:
    """Neither written nor read: a reader would fill rows up with a pad that the type cannot hold."""
    good = CODES.codebook
    assert good is not None
    with pytest.raises(ValueError, match="codebook: "):
        Field.from_json({**CODES.to_json(), "codebook": {**good.to_json(), **BAD_BOOKS[case]}})
    changes = {key: tuple(v) if isinstance(v, list) else v for key, v in BAD_BOOKS[case].items()}
    with raises_message(StoreError, "codebook"):
        write_codes(make_store, out, dataclasses.replace(CODES, codebook=dataclasses.replace(good, **changes)))


def test_windows_begin_at_a_row_of_every_field(make_store: Any) -> None:
    fields = random_fields({"pose": 3}, {"slow": 2}, slow=15)
    made = make_store(fields=fields, clips={"train": 1}, n_frames=(90, 90), length=30, stride=20)
    assert "the stride" in errors_after(made.path, "windows/start", 1, 22)
    change_json(made.path, lambda info: info["windows"].update(stride=2))
    assert errors_after(made.path, "windows/start", 1, 22) == ""
    assert "/windows: rows of slow are outside the field, in windows 1" in errors_after(
        made.path, "windows/start", 1, 23
    )


@pytest.mark.parametrize("text", ["1e999999999", "1/0", "nan", "0x1"])
def test_seconds_are_fractions(make_store: Any, text: str) -> None:
    made = make_store()
    with h5py.File(made.path / TABLES, "r+", locking=False) as file:
        file["clips/audio_start"] = np.full(
            len(file["clips/id"]), text.encode(), dtype=h5py.string_dtype("utf-8", 16)
        )
    seal(made.path)
    assert "audio_start" in only_error(made.path)
    with raises_message(StoreError, "fraction"):
        _ = next(iter(open_store(made.path).clips())).audio_start


@pytest.mark.parametrize(
    ("column", "row", "value", "message"),
    [
        ("clips/source", 1, b"nobody", "source: clips that do not exist, or are copies, in rows 1 (clip copy)"),
        ("clips/source", 1, b"copy", "source: clips that do not exist, or are copies, in rows 1 (clip copy)"),
        ("clips/source_rate", 0, b"ab", "/clips/source_rate of clip 'alone': not a rate"),
        ("clips/source_rate", 0, b"0", "/clips/source_rate of clip 'alone': not a rate"),
        ("clips/height_m", 0, 1e30, "/clips/height_m of clip 'alone': not a number from 0"),
        ("clips/song", 0, b"no", "/clips/song: songs that do not exist, in rows 0 (clip alone)"),
        ("groups/n_source", 0, -3, "/groups/n_source: a number is out of bounds"),
        ("groups/n_source", 0, 1, "group train0: dancers 0, 1 of 1"),
        ("songs/sample_rate", 0, 0, "/songs/sample_rate: a number is out of bounds"),
        ("songs/n_samples", 0, -1, "/songs/n_samples: a number is out of bounds"),
        ("segments/label", 0, b"", "/segments/label: a quality flag without its kind, in rows 0 (clip alone)"),
        ("segments/data", 0, b"[", "/segments, row 0: a segment of the dataset cannot be read"),
    ],
)  # fmt: skip
def test_lies_in_tables(out: Path, column: str, row: int, value: Any, message: str) -> None:
    signal = Signal("ab" * 32, 48_000, 100)
    more: dict[str, Any] = {"song": "tune", "signal": signal, "source_rate": "60", "height_m": 1.7}
    clips = [dataclasses.replace(clip, **more) for clip in stored({"train": (2,)})]
    copy = dataclasses.replace(clips[-1], id="copy", source="alone")
    write_store(out, HEADER, [*clips, copy], quality=[{"clip": "alone", "kind": "steady_music", "value": 0.1}])
    assert verify_store(out) == []
    edit(out, column, row, value, "segments.h5" if column.startswith("segments") else TABLES)
    assert message in only_error(out)
    if column == "segments/data":
        with open_store(out) as store, raises_message(StoreError, "quality flags", where="out"):
            _ = store.quality


def test_copy_of_a_clip_of_another_split(make_store: Any, out: Path) -> None:
    made = make_store()
    copy = dataclasses.replace(made.clips[0], id="test_c00__mirror", source="test_c00")
    write_store(out, made.header, [copy, *made.clips[1:]])
    assert "is a copy of test_c00 of test" in only_error(out)


def test_files_that_belong_to_nothing(make_store: Any) -> None:
    made = make_store()
    (made.path / "train-00000-of-00009.h5").write_bytes(b"")
    (made.path / "my notes.txt").write_text("left alone")
    [problem] = verify_store(made.path)
    assert problem.severity == "note"
    assert problem.where.endswith("train-00000-of-00009.h5")


def test_memory_does_not_grow_with_the_dataset(tmp_path: Path) -> None:
    fields = random_fields({"pose": 400}, {})
    write_random_store(
        tmp_path / "s", fields=fields, clips={"train": 15}, n_frames=(2000, 2000), length=1000, stride=500,
        shard_bytes=1 << 30,
    )  # fmt: skip
    size = (tmp_path / "s" / TRAIN).stat().st_size
    tracemalloc.start()
    try:
        assert verify_store(tmp_path / "s") == []
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert size > 45e6
    assert peak < 30e6


def test_a_tempo_that_is_infinite_is_unknown(make_store: Any) -> None:
    made = make_store()
    edit(made.path, "clips/tempo_bpm", 0, np.inf, TABLES)
    with open_store(made.path) as store:
        assert next(iter(store)).tempo_bpm is None


def test_a_group_has_no_name_of_a_single_clip(out: Path) -> None:
    """Both would be one id of a sample."""
    write_store(out, HEADER, stored({"train": (2,)}))
    with h5py.File(out / TABLES, "r+", locking=False) as file:
        groups = file["clips/group"][...]
        file["clips/id"][np.flatnonzero(groups == b"")[0]] = groups[groups != b""][0]
    seal(out)
    assert any("no dancers" in str(p) for p in verify_store(out)), verify_store(out)
