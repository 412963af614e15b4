"""Readers across `build --overwrite`: the dataset that was opened, bit for bit, or StoreError; never another one."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from torch.utils.data import DataLoader

from dancedata.building.out_folder import locked, new_dataset
from dancedata.core.errors import StoreError
from dancedata.store.dataset import open_store
from dancedata.testing.stores import random_fields
from dancedata.torch import BatchLoader, WindowDataset

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning"),
]
Rows = dict[tuple[str, int], npt.NDArray[Any]]
FIELDS = ("pose", "turn")
Overwrite = Callable[[Path, int], None]
BUILT_AGAIN = r"built again since it was opened"


@pytest.fixture(scope="session")
def write(random_store: Callable[..., Any]) -> Overwrite:
    """Return a function that writes a dataset; those of all seeds have files of the same names and sizes."""
    fields = random_fields({"pose": 21, "turn": 5}, {})

    def write(folder: Path, seed: int) -> None:
        random_store(
            folder, fields=fields, n_frames=(90, 90), length=30, stride=15, clips={"train": 8, "val": 2},
            shard_bytes=1 << 14, seed=seed,
        )  # fmt: skip

    return write


@pytest.fixture
def overwrite(write: Overwrite) -> Overwrite:
    """Return a function that replaces a dataset as a build does."""

    def overwrite(out: Path, seed: int) -> None:
        with locked(out), new_dataset(out) as folder:
            write(folder, seed)

    return overwrite


@pytest.fixture
def out(tmp_path: Path, write: Overwrite) -> Path:
    """A dataset of several shards."""
    write(tmp_path / "out", 1)
    return tmp_path / "out"


@pytest.fixture(scope="session")
def truth(tmp_path_factory: pytest.TempPathFactory, write: Overwrite) -> Rows:
    """Every train window of the dataset of seed 1, by clip and start: pose and turn side by side."""
    folder, other = (tmp_path_factory.mktemp("truth") / "out" for _ in range(2))
    write(folder, 1)
    write(other, 2)
    sizes = [{p.name: p.stat().st_size for p in f.glob("train-*")} for f in (folder, other)]
    assert sizes[0] == sizes[1]
    assert len(sizes[0]) > 2
    with open_store(folder) as ds:
        return {(w.clip, w.start): np.hstack([ds.read(w, f) for f in FIELDS]) for w in ds.windows("train")}


def of_batches(batches: Any) -> Rows:
    found = {}
    for batch in batches:
        for clip, start, *rows in zip(batch["clip"], batch["start"], *(batch[f] for f in FIELDS), strict=True):
            found[clip, int(start)] = np.hstack([np.asarray(r) for r in rows])
    return found


def of_store(out: Path) -> Callable[[], Rows]:
    ds = open_store(out)
    windows = ds.windows("train")
    return lambda: {(w.clip, w.start): np.hstack([ds.read(w, f) for f in FIELDS]) for w in windows}


def of_dataset(out: Path, **options: Any) -> Callable[[], Rows]:
    dataset = WindowDataset(open_store(out, **options), fields=FIELDS, scale=None)
    return lambda: of_batches([{k: [v] for k, v in dataset[i].items()} for i in range(len(dataset))])


def of_batch_loader(out: Path, **options: Any) -> Callable[[], Rows]:
    loader = BatchLoader(WindowDataset(open_store(out, **options), fields=FIELDS, scale=None), 8)
    return lambda: of_batches(loader)


def of_workers(out: Path, method: str, persistent: bool, **options: Any) -> Callable[[], Rows]:
    dataset = WindowDataset(open_store(out, **options), fields=FIELDS, scale=None)
    # One where they start slowly: torch complains if the first one's error comes before the second one exists.
    n_workers = 2 if method == "fork" else 1
    loader = DataLoader(
        dataset, 8, num_workers=n_workers, persistent_workers=persistent, multiprocessing_context=method
    )

    def read() -> Rows:
        batches = iter(loader)
        try:
            return of_batches(batches)
        except StoreError:
            # The traceback holds the iterator: left to the garbage collector, it waits 5 s for each worker.
            batches._shutdown_workers()  # type: ignore[attr-defined]
            raise

    return read


#: Way of reading, and whether a reader that has read before continues with its open files.
KINDS: list[Any] = [
    pytest.param(of_store, {}, True, id="store"),
    pytest.param(of_dataset, {}, True, id="dataset, mapped"),
    pytest.param(of_dataset, {"mapped": False}, True, id="dataset, by position"),
    pytest.param(of_batch_loader, {}, True, id="batch loader, mapped"),
    pytest.param(of_batch_loader, {"mapped": False}, True, id="batch loader, by position"),
]
for _method in ("fork", "spawn", "forkserver"):
    _marks = [] if _method == "fork" else [pytest.mark.nightly]
    for _persistent in (False, True):
        KINDS.append(
            pytest.param(
                of_workers, {"method": _method, "persistent": _persistent}, _persistent, marks=_marks,
                id=f"{_method}, {'persistent' if _persistent else 'new workers'}",
            )
        )  # fmt: skip
KINDS.append(
    pytest.param(of_workers, {"method": "fork", "persistent": False, "mapped": False}, False, id="fork, by position")
)


def assert_equal(found: Rows, wanted: Rows) -> None:
    assert found.keys() == wanted.keys()
    for window, rows in wanted.items():
        np.testing.assert_array_equal(found[window], rows)


@pytest.mark.parametrize(("reader", "options", "goes_on"), KINDS)
def test_a_reader_keeps_its_open_files_or_stops(out, overwrite, truth, reader, options, goes_on):
    read, late = reader(out, **options), reader(out, **options)
    assert_equal(read(), truth)
    overwrite(out, 2)
    with pytest.raises(StoreError, match=BUILT_AGAIN):
        late()  # what has not been read before stops
    if goes_on:
        assert_equal(read(), truth)
    else:
        with pytest.raises(StoreError, match=BUILT_AGAIN):
            read()
    # Opened again, it is the other one.
    again = reader(out, **options)()
    assert again.keys() == truth.keys()
    assert not any(np.array_equal(again[window], rows) for window, rows in truth.items())


@pytest.mark.parametrize(("reader", "options", "goes_on"), KINDS)
def test_a_dataset_that_is_written_over_in_place_stops_its_readers(out, write, tmp_path, reader, options, goes_on):
    write(tmp_path / "other", 2)
    read = reader(out, **options)
    read()
    for path in out.glob("*.h5"):
        os.utime(path)  # a file that was touched has the same bytes
    read()
    for path in out.glob("*.h5"):
        before = path.stat()
        path.write_bytes((tmp_path / "other" / path.name).read_bytes())
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # that of its content, not of its inode
    time.sleep(0.02)  # files are looked at every 10 ms
    with pytest.raises(StoreError, match=rf"not those that the build wrote|{BUILT_AGAIN}"):
        read()


@pytest.mark.parametrize("reader", [of_dataset, of_batch_loader])
def test_a_mapped_file_that_was_cut_off_is_not_read(out: Path, reader: Callable[..., Callable[[], Rows]]) -> None:
    """The system ends a process that reads a page of a mapped file beyond its end."""
    read = reader(out)
    read()
    for path in out.glob("train-*.h5"):
        os.truncate(path, 100)
    time.sleep(0.02)
    with pytest.raises(StoreError, match="not those that the build wrote"):
        read()


def test_forked_workers_keep_the_files_mapped_by_their_parent(out: Path, overwrite: Overwrite, truth: Rows) -> None:
    dataset = WindowDataset(out, fields=FIELDS, scale=None)
    _ = dataset[0]
    overwrite(out, 2)
    loader = DataLoader(dataset, 8, num_workers=2, multiprocessing_context="fork")
    assert_equal(of_batches(loader), truth)


def test_an_overwrite_with_the_same_data_stops_nobody(out: Path, overwrite: Overwrite, truth: Rows) -> None:
    reads = [of_store(out), of_dataset(out), of_workers(out, "fork", False), of_batch_loader(out, mapped=False)]
    overwrite(out, 1)
    for read in reads:
        assert_equal(read(), truth)


def test_a_scaler_is_not_taken_from_another_dataset(out: Path, overwrite: Overwrite) -> None:
    known, late = open_store(out), open_store(out)
    scale = known.scaler("pose").scale
    overwrite(out, 2)
    np.testing.assert_array_equal(known.scaler("pose").scale, scale)
    with pytest.raises(StoreError, match=BUILT_AGAIN):
        late.scaler("pose")
    for name in ("rejects", "quality"):  # equal in both
        assert getattr(late, name) == getattr(known, name)
