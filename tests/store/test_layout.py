"""The layout on disk, as docs/reference/store.md has it, whose snippets need no package; equal bytes."""

import dataclasses
import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dancedata
from dancedata.core.errors import StoreError
from dancedata.store import hdf5, open_store, verify_store, write_store
from dancedata.store.hdf5 import SparseFile
from dancedata.testing.stores import RandomStore, random_fields, write_random_store
from dancedata.torch import WindowDataset


def datasets(file: Any) -> dict[str, Any]:
    """All datasets of an HDF5 file by path."""
    found: dict[str, Any] = {}
    file.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    return found


def hashes(folder: Path) -> dict[str, str]:
    """sha256 of every file of a folder."""
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


def test_data_is_aligned_contiguous_and_little_endian(make_store: Any) -> None:
    made = make_store(shard_bytes=5000)
    shards = list(made.path.glob("*.h5"))
    assert len(shards) > 5
    for shard in shards:
        with h5py.File(shard, "r", locking=False) as file:
            for name, dataset in datasets(file).items():
                assert dataset.chunks is None, name
                assert dataset.compression is None, name
                assert dataset.dtype.str[0] in "<|", name
                assert dataset.size == 0 or dataset.id.get_offset() % 64 == 0, name


def test_names_are_the_documented_ones(make_store: Any) -> None:
    made = make_store()
    columns = ("id", "split", "file", "genre", "music", "dancer", "tempo_bpm", "n_frames", "n_flags")
    tables = {f"clips/{n}" for n in (*columns, "lists/offset", "lists/values")} | {"windows/clip", "windows/start"}
    tables |= {f"clips/motion/{n}/{c}" for n in ("pose", "fast") for c in ("start", "length")}
    tables |= {f"clips/audio/{n}/{c}" for n in ("music", "layer") for c in ("start", "length", "offset")}
    with h5py.File(made.path / "train-00000-of-00001.h5", "r", locking=False) as file:
        assert set(datasets(file)) == {"motion/pose", "motion/fast", "audio/music", "audio/layer"}
        assert file["motion/pose"].dtype == "<f4"
        assert file["audio/layer"].dtype == "<f2"
        assert (file.attrs["format"], file.attrs["split"], file.attrs["fps"]) == (3, b"train", b"30")
    with h5py.File(made.path / "tables.h5", "r", locking=False) as file:
        # Columns that no clip has a value of are left out.
        assert set(datasets(file)) == tables
        assert file["clips/id"].asstr()[1] == "train_c01"
        assert set(file["clips/file"].asstr()[:6]) == {"train-00000-of-00001.h5"}
        assert file["windows"].attrs["length"] == 30
        assert np.isnan(file["clips/tempo_bpm"][1])


def test_strings_have_a_fixed_length(make_store: Any) -> None:
    """A damaged heap of HDF5's strings of variable length makes the library hang."""
    for path in make_store().path.glob("*.h5"):
        with h5py.File(path, "r", locking=False) as file:
            items = [file, *(file[name] for name in datasets(file)), file.get("windows", file)]
            texts = [item.attrs.get_id(name).dtype for item in items for name in item.attrs]
            assert all(dtype.kind in "iS" for dtype in texts)
            assert all(dataset.dtype.kind in "iufS" for dataset in datasets(file).values())


def test_long_texts_are_lists_of_bytes(make_store: Any, out: Path) -> None:
    made = make_store(clips={"train": 3})
    clips = [dataclasses.replace(c, columns={"says": "é" * n}) for c, n in zip(made.clips, (64, 65, 0), strict=True)]
    write_store(out, made.header, clips)
    with h5py.File(out / "tables.h5", "r", locking=False) as file:
        says = file["clips/x/says"]
        assert says["offset"][...].tolist() == [0, 128, 258, 258]
        assert says["values"][...].tobytes().decode() == "é" * 129
    assert [clip.columns.get("says") for clip in open_store(out).clips()] == ["é" * 64, "é" * 65, None]
    assert verify_store(out) == []


SCRIPT = """
import sys
from pathlib import Path
from dancedata.testing.stores import write_random_store
write_random_store(Path(sys.argv[1]), shard_bytes=200000, card="# é")
"""


def test_equal_input_gives_equal_bytes_in_another_process_and_second(tmp_path: Path) -> None:
    for name in ("first", "second"):
        subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path / name)], check=True)
        # HDF5 stores times in seconds: a stored time would differ now.
        time.sleep(1.1 if name == "first" else 0)
    first = hashes(tmp_path / "first")
    assert first == hashes(tmp_path / "second")
    assert len([n for n in first if n.endswith(".h5")]) > 3


def test_order_of_the_clips_given_does_not_matter(tmp_path: Path, make_store: Any) -> None:
    made = make_store(shard_bytes=5000)
    out = tmp_path / "other"
    out.mkdir()
    write_store(out, made.header, made.clips[::-1], shard_bytes=5000)
    assert hashes(out) == hashes(made.path)


def test_shards_keep_to_their_size(make_store: Any) -> None:
    made = make_store(clips={"train": 12}, shard_bytes=20_000, clips_per_song=1)
    shards = json.loads((made.path / "dataset.json").read_text())["shards"]
    assert [s["file"] for s in shards] == [f"train-{i:05d}-of-{len(shards):05d}.h5" for i in range(len(shards))]
    store = open_store(made.path)
    sizes = []
    for shard in store._shards("train"):
        sizes.append(sum(shard.layout(f).n_rows * shard.layout(f).row_bytes for f in store.fields))
        assert sizes[-1] <= 20_000 or shard.n_clips == 1
    assert len(sizes) > 2
    # Two neighbours never fit into one.
    assert all(a + b > 20_000 for a, b in pairwise(sizes))


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(3,), dtype="f4")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "x", shape=(3,))
    file.create_virtual_dataset("a/x", layout)


#: What may be at a name instead of a dataset, and what the error says was found.
NO_DATASETS: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "nothing": (lambda file: file.create_group("a"), "nothing"),
    "no group": (lambda file: file.create_dataset("a", data=[1.0]), "nothing"),
    "link": (lambda file: file.create_group("a").__setitem__("x", h5py.SoftLink("/b")), "SoftLink"),
    "link to a file": (
        lambda file: file.create_group("a").__setitem__("x", h5py.ExternalLink("other.h5", "/b")),
        "ExternalLink",
    ),
    "link to a group": (lambda file: file.__setitem__("a", h5py.SoftLink("/")), "SoftLink"),
    "group": (lambda file: file.create_group("a/x"), "Group"),
    "empty": (lambda file: file.create_dataset("a/x", data=h5py.Empty("f4")), "Dataset"),
    "texts": (lambda file: file.create_dataset("a/x", data=["text"]), "object"),
    "pairs": (lambda file: file.create_dataset("a/x", data=np.zeros(2, "f4,i4")), "[('f0', '<f4'), ('f1', '<i4')]"),
    "other file": (
        lambda file: file.create_dataset("a/x", (3,), "f4", external=[("raw.bin", 0, 12)]),
        "chunks, or virtual or external storage",
    ),
    "virtual": (_virtual, "chunks, or virtual or external storage"),
}


@pytest.mark.parametrize(("make", "found"), NO_DATASETS.values(), ids=NO_DATASETS)
def test_only_plain_datasets_are_read(tmp_path: Path, make: Callable[[h5py.File], object], found: str) -> None:
    with h5py.File(tmp_path / "shard.h5", "w") as file:
        make(file)
        file["b"] = [1.0, 2.0]
    with hdf5.open_file(tmp_path / "shard.h5") as file:
        with pytest.raises(StoreError) as caught:
            hdf5.find_dataset(file, "a/x")
        assert caught.value.found == found
        assert hdf5.find_dataset(file, "/b")[...].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("size", [1 << 40, 1 << 62])
def test_a_dataset_that_is_larger_than_its_file_is_refused(tmp_path: Path, size: int) -> None:
    with h5py.File(tmp_path / "shard.h5", "w") as file:
        file.create_dataset("plain", (size // 4,), "f4")
        file.create_dataset("zipped", (1 << 30,), "f4", chunks=(1 << 20,), compression="gzip")
    with hdf5.open_file(tmp_path / "shard.h5") as file:
        for name in ("plain", "zipped"):
            with pytest.raises(StoreError):
                hdf5.find_dataset(file, name)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 300_000), st.binary(min_size=1, max_size=200), st.integers(1, 900)), max_size=8)
)
def test_same_as_bytes_io(writes: list[tuple[int, bytes, int]]) -> None:
    sparse, plain = SparseFile(), io.BytesIO()
    for position, data, repeats in writes:
        for file in (sparse, plain):
            file.seek(position)
            assert file.write(data * repeats) == len(data) * repeats
    size = sparse.seek(0, io.SEEK_END)
    assert size == len(plain.getvalue())
    for position, data, _ in writes:
        sparse.seek(position)
        assert sparse.read(100) == plain.getvalue()[position : position + 100], data
    sparse.seek(0)
    assert sparse.readall() == plain.getvalue()
    for end in (size + 5000, size // 2):
        sparse.truncate(end)
        with tempfile.TemporaryFile() as file:
            sparse.copy_to(file)
            file.seek(0)
            assert file.read() == plain.getvalue()[:end].ljust(end, b"\0")


PAGE = Path(__file__).parents[2] / "docs" / "reference" / "store.md"
READ, PANDAS, WRITE = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
SHOWN = "train_c00 motion/edge151 (30, 151)\ntrain_c00 audio/librosa35 (60, 35)\n"


@pytest.fixture
def made(tmp_path: Path) -> RandomStore:
    """Two fields of the page's names, music with two rows a frame."""
    fields = random_fields({"edge151": 151}, {"librosa35": 35}, librosa35=60)
    return write_random_store(tmp_path / "made", fields=fields)


def run(code: str, folder: Path) -> dict[str, Any]:
    """Run a snippet; nothing of it needs this package."""
    assert "dancedata" not in code
    names: dict[str, Any] = {"OUT": str(folder)}
    exec(code, names)
    return names


def test_a_window_is_read_with_h5py_alone(made: RandomStore, capsys: Any) -> None:
    names = run(READ, made.path)
    names["tables"].close()
    assert capsys.readouterr().out == SHOWN
    np.testing.assert_array_equal(names["window"], made.rows("train_c00", "librosa35", 0, 30))


def windows_by_h5py(folder: Path, field: str) -> list[np.ndarray]:
    """Read every window of a dataset as the page reads the first one."""
    code = READ.replace('("motion/edge151", "audio/librosa35")', f'("{field}",)')
    with dancedata.open(folder) as store:
        n = sum(len(store.windows(split)) for split in store.splits)
    rows = []
    for number in range(n):
        names = run(code.replace('{name}"][0]', f'{{name}}"][{number}]'), folder)
        names["tables"].close()
        rows.append(names["window"])
    return rows


@pytest.mark.parametrize("field", ["motion/edge151", "audio/librosa35"])
def test_h5py_reads_the_windows_that_dancedata_reads(made: RandomStore, field: str) -> None:
    theirs = windows_by_h5py(made.path, field)
    with open_store(made.path) as store:
        ours = [store.read(w, field.split("/")[1]) for split in store.splits for w in store.windows(split)]
    assert len(ours) == len(theirs) > 20
    assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_columns_with_pandas(made: RandomStore) -> None:
    pytest.importorskip("pandas")
    names = run(READ + PANDAS.replace("print(", "frame = ("), made.path)
    names["tables"].close()
    assert names["frame"]["id"].tolist() == [clip.id for clip in made.clips]
    assert set(names["frame"]["split"]) == {"train", "val", "test"}


def test_a_dataset_that_h5py_wrote_is_opened_checked_and_read(tmp_path: Path) -> None:
    names = run(WRITE, tmp_path / "own")
    rows = np.random.default_rng(0).normal(size=(90, 15)).astype(np.float32)
    assert verify_store(tmp_path / "own") == []
    with open_store(tmp_path / "own") as store:
        assert names["document"]["splits"]["train"]["windows"] == len(store.windows("train")) == 5
        assert store.rejects == store.quality == []
        for window in store.windows("train"):
            np.testing.assert_array_equal(store.read(window, "points"), rows[window.start : window.start + 30])
        np.testing.assert_array_equal(store["walk"]["points"], rows)
    samples = WindowDataset(tmp_path / "own", "train", scale=None)
    np.testing.assert_array_equal(samples[2]["points"].numpy(), rows[30:60])


@pytest.mark.nightly
@pytest.mark.parametrize("version", ["==3.11.*", ""])
def test_the_page_where_this_package_is_not_installed(made: RandomStore, tmp_path: Path, version: str) -> None:
    packages = tmp_path / "packages"
    install = [sys.executable, "-m", "pip", "install", "-q", "--target", str(packages), f"h5py{version}", "pandas"]
    subprocess.run(install, check=True)
    code = f"import sys; sys.path.insert(0, {str(packages)!r}); OUT = {str(made.path)!r}\n{READ}{PANDAS}"
    code += f"OUT = {str(tmp_path / 'own')!r}\n{WRITE}import importlib.util as i\nprint(i.find_spec('dancedata'))\n"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.startswith(SHOWN)
    assert done.stdout.endswith("None\n")
    assert verify_store(tmp_path / "own") == []
