"""parquet: rows are the dataset's bit for bit, as pyarrow and Hugging Face's datasets read them."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.core.codebook import Codebook
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import MissingPackageError
from dancedata.store import Store, open_store
from dancedata.store.schema import Field
from dancedata.store.writer import write_store
from dancedata.testing.stores import random_columns, random_fields, write_random_store
from tests.messages import raises_message

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

CODES = Codebook("steps", (7, 300), "ab" * 32, -1)
FIELDS = (
    *random_fields({"edge151": 151}, {"librosa35.60": 35}, **{"librosa35.60": 60}),
    Field("half", "motion", random_columns(4), Fraction(30), "float16"),
)
TOKENS = Field("tokens", "motion", Columns((Group("code", 2, "1"),)), Fraction(15), "int16", CODES)
#: Free columns of every type.
FREE: dict[str, Any] = {
    "level": 3, "score": 0.1 + 0.2, "ok": True, "teacher": "Änn", "tags": ("a", "b"), "marks": (1, 2), "at": (0.1,),
}  # fmt: skip


def make(folder: Path, splits: dict[str, int] | None = None) -> Path:
    made = write_random_store(
        folder / "random", fields=FIELDS, stride=10, clips=splits or {"train": 5, "val": 2, "test": 2}
    )
    rng = np.random.default_rng(1)
    clips = [
        replace(
            clip,
            columns=FREE if k % 2 else {},
            motion={**clip.motion, "tokens": rng.integers(-1, 7, (-(-clip.n_frames // 2), 2)).astype(np.int16)},
        )
        for k, clip in enumerate(made.clips)
    ]
    meta = {"name": "random", "licence": "CC BY-NC 4.0", "citation": "Ann et al."}
    out = folder / "store"
    out.mkdir()
    write_store(out, replace(made.header, fields=(*FIELDS, TOKENS), meta=meta), clips)
    return out


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def store(path: Path) -> Store:
    return open_store(path)


def equal_bits(found: Any, wanted: Any) -> None:
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert (found.dtype, found.shape) == (wanted.dtype.newbyteorder("="), wanted.shape)
    assert found.tobytes() == wanted.tobytes()


def rows_of(array: Any, field: str, k: int) -> np.ndarray[Any, Any]:
    """Return sample k of a column of pyarrow as the array that its own buffer holds."""
    cells = array[k].values
    return np.asarray(cells.flatten().to_numpy(zero_copy_only=False)).reshape(len(cells), -1)


def windows_equal(table: Any, store: Store, split: str) -> None:
    windows = list(store.windows(split))
    assert table.num_rows == len(windows)
    assert table["clip"].to_pylist() == [w.clip for w in windows]
    assert table["start"].to_pylist() == [w.start for w in windows]
    for name in store.fields:
        column = table[name].combine_chunks()
        for k, window in enumerate(windows):
            equal_bits(rows_of(column, name, k), store.read(window, name))


def test_parquet_holds_every_window_bit_for_bit(path: Path, store: Store, tmp_path: Path) -> None:
    done = dancedata.export(path, "parquet", tmp_path / "out", progress=False, shard_mb=0.5, row_group_mb=0.2)
    for split in store.splits:
        files = sorted((tmp_path / "out/data").glob(f"{split}-*.parquet"))
        assert len(files) > (split == "train")
        assert [f.name for f in files] == [f"{split}-{k:05d}-of-{len(files):05d}.parquet" for k in range(len(files))]
        windows_equal(pa.concat_tables([pq.read_table(file) for file in files]), store, split)
        for file in map(pq.ParquetFile, files):
            rows = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
            one = sum(store.read(store.windows(split)[0], name).nbytes for name in store.fields)
            assert all(n == 1 or n * one <= 0.2 * 2**20 for n in rows)
            assert sum(rows) * one <= 0.5 * 2**20
    index = json.loads((tmp_path / "out/index.json").read_text())
    assert sum(index["rows"].values()) == sum(len(store.windows(split)) for split in store.splits)
    assert (
        index["fields"]["edge151"]["statistics"] == json.loads((path / "stats.json").read_text())["fields"]["edge151"]
    )
    assert index["fields"]["edge151"]["scaler_sha256"] == store.scaler("edge151").sha256
    assert done.about["licence"] == "CC BY-NC 4.0"


def test_parquet_of_clips_has_the_table_of_pandas(path: Path, store: Store, tmp_path: Path) -> None:
    dancedata.export(path, "parquet", tmp_path / "out", progress=False, samples="clips", fields=("edge151", "tokens"))
    tables = [pq.read_table(file) for split in store.splits for file in (tmp_path / "out/data").glob(f"{split}-*")]
    table = pa.concat_tables(tables)
    facts = table.drop_columns(["edge151", "tokens"]).to_pylist()
    wanted = store.to_pandas("clips").astype(object)
    wanted = wanted.where(wanted.notna(), None).to_dict("records")
    for row, expected in zip(facts, wanted, strict=True):
        assert row == {key: list(value) if isinstance(value, tuple) else value for key, value in expected.items()}
    for name in ("edge151", "tokens"):
        column = table[name].combine_chunks()
        for k, clip in enumerate(store.clips()):
            equal_bits(rows_of(column, name, k), clip[name])
    about = json.loads(tables[0].schema.metadata[b"dancedata"])
    assert (about["licence"], about["citation"]) == ("CC BY-NC 4.0", "Ann et al.")
    assert about["fields"]["edge151"]["columns"] == store.fields["edge151"].to_json()


def test_the_card_is_what_hubs_read(path: Path, store: Store, tmp_path: Path) -> None:
    dancedata.export(path, "parquet", tmp_path / "out", progress=False)
    head = yaml.safe_load((tmp_path / "out/README.md").read_text().split("---\n")[1])
    assert head["license"] == "cc-by-nc-4.0"
    files = head["configs"][0]["data_files"]
    assert [(f["split"], f["path"]) for f in files] == [(split, f"data/{split}-*.parquet") for split in store.splits]
    assert "CC BY-NC 4.0" in (tmp_path / "out/LICENCE.txt").read_text()


def test_a_field_with_the_name_of_a_column_is_refused(tmp_path: Path) -> None:
    fields = random_fields({"edge151": 151}, {"music": 3})
    made = write_random_store(tmp_path / "store", fields=fields, clips={"train": 1})
    with raises_message(StoreError, "column of facts", where="store"):
        dancedata.export(made.path, "parquet", tmp_path / "out", progress=False)
    dancedata.export(made.path, "parquet", tmp_path / "out", progress=False, fields=("edge151",))


@pytest.fixture
def hf(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", reason="Hugging Face's datasets is not installed")
    datasets.disable_progress_bars()
    return datasets


def hf_equal(data: Any, store: Store) -> None:
    """Compare every window of every split with the dataset, as Arrow, numpy and torch have them."""
    assert list(data) == list(store.splits)
    for split in store.splits:
        windows = list(store.windows(split))
        assert data[split]["clip"][:] == [w.clip for w in windows]
        assert data[split]["x/level"][:] == [store[w.clip].columns.get("level") for w in windows]
        windows_equal(data[split].data.table, store, split)
        arrays = data[split].with_format("numpy")  # half floats as float32, whole numbers as int64
        for k, window in enumerate(windows):
            row = arrays[k]
            for name in store.fields:
                equal_bits(row[name].astype(store.field(name).dtype), store.read(window, name))
    tensors = data["train"].with_format("torch", columns=["edge151"])[:3]["edge151"]
    equal_bits(tensors.numpy(), np.stack([store.read(w, "edge151") for w in store.windows("train")[:3]]))


@pytest.mark.parametrize("of", ["files", "folder"])
def test_load_dataset_reads_parquet(path: Path, store: Store, tmp_path: Path, hf: Any, of: str) -> None:
    dancedata.export(path, "parquet", tmp_path / "out", progress=False, shard_mb=0.5)
    cache = str(tmp_path / "cache")
    if of == "folder":  # by the head of README.md
        return hf_equal(hf.load_dataset(str(tmp_path / "out"), cache_dir=cache), store)
    files = {split: str(tmp_path / f"out/data/{split}-*.parquet") for split in store.splits}
    hf_equal(hf.load_dataset("parquet", data_files=files, cache_dir=cache), store)


def test_names_of_splits_that_datasets_does_not_take(tmp_path: Path, hf: Any) -> None:
    """A split that datasets has no name for is written, with a note."""
    dataset = make(tmp_path, {"train": 2, "cross-modal": 2})
    done = dancedata.export(dataset, "parquet", tmp_path / "out", progress=False)
    assert "cross-modal" in done.notes[0]
    files = {"test": str(tmp_path / "out/data/cross-modal-*.parquet")}
    data = hf.load_dataset("parquet", data_files=files, cache_dir=str(tmp_path / "cache"))
    assert len(data["test"]) == len(open_store(dataset).windows("cross-modal"))
    assert list(hf.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))) == ["train"]


def test_refusals(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for keys in ({"shard_mb": 0}, {"row_group_mb": 0}):
        with raises_message(UsageError, r"export\.parquet"):
            dancedata.export(path, "parquet", tmp_path / "out", progress=False, **keys)
    with raises_message(StoreError, r"librosa35\.60", where="store"):
        dancedata.export(path, "parquet", tmp_path / "out", progress=False, fields=("edge",))
    monkeypatch.setattr("dancedata.core.packages._is_installed", lambda module: False)
    with pytest.raises(MissingPackageError, match="--to parquet needs pyarrow"):
        dancedata.export(path, "parquet", tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()
