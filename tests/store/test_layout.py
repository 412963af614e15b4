"""The layout on disk, as documented in docs/reference/store.md, equal bytes for equal input, and sparse files."""

import dataclasses
import hashlib
import io
import json
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

from dancedata.core.errors import StoreError
from dancedata.store import hdf5, open_store, verify_store, write_store
from dancedata.store.hdf5 import SparseFile


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


WRITE = """
import sys
from pathlib import Path
from dancedata.testing.stores import write_random_store
write_random_store(Path(sys.argv[1]), shard_bytes=200000, card="# é")
"""


def test_equal_input_gives_equal_bytes_in_another_process_and_second(tmp_path: Path) -> None:
    for name in ("first", "second"):
        subprocess.run([sys.executable, "-c", WRITE, str(tmp_path / name)], check=True)
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


def test_dataset_json(make_store: Any) -> None:
    made = make_store(meta={"recipe": {"name": "x"}, "licence": "CC0"})
    info = json.loads((made.path / "dataset.json").read_text())
    assert (info["format"], info["fps"]) == (3, "30")
    assert info["windows"] == {"length": 30, "stride": 15}
    fields = [" ".join(f[key] for key in ("name", "kind", "rate", "dtype")) for f in info["fields"]]
    assert fields[:2] == ["pose motion 30 float32", "fast motion 60 float32"]
    assert fields[2:] == ["music audio 30 float32", "layer audio 30 float16"]
    assert info["recipe"] == {"name": "x"}
    assert info["licence"] == "CC0"
    train = [c for c in made.clips if c.split == "train"]
    frames = sum(c.n_frames for c in train)
    assert info["splits"]["train"] == {
        "clips": 6, "windows": sum(len(c.starts) for c in train), "frames": frames, "hours": frames / 108_000,
        "songs": 3,
    }  # fmt: skip
    for entry in info["shards"]:
        data = (made.path / entry["file"]).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry["size"], entry["sha256"])
    assert set(info["files"]) == {"tables.h5", "stats.json", "rejects.jsonl", "README.md"}


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
