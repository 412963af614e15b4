"""The formats that benchmarks/reading.py compares with: writing each, and reading a sample."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from dancedata.torch import EpochSampler, WindowDataset

BATCH = 64
Sample = dict[str, torch.Tensor]


@dataclass(frozen=True)
class Source:
    """The windows that all formats store, and a folder for them."""

    folder: Path
    dataset: WindowDataset

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the arrays of a window."""
        return self.dataset.fields

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.dataset)

    @property
    def n_bytes(self) -> int:
        """Bytes of all windows, each counted by itself."""
        return len(self) * sum(self.array(0, name).nbytes for name in self.fields)

    def array(self, index: int, name: str) -> np.ndarray[Any, Any]:
        """Read one array of one window."""
        return self.dataset.store.read(self.dataset.windows[index], name)


class Peer(Dataset[Sample]):
    """One format: writing it, and reading a sample."""

    name: ClassVar[str] = ""
    #: The package that it needs.
    package: ClassVar[str | None] = None
    #: True if windows are in the order of the files, not in the sampler's.
    in_order: ClassVar[bool] = False

    def __init__(self, source: Source) -> None:
        self.fields, self.n = source.fields, len(source)
        self.folder = source.folder / type(self).__name__

    def write(self, source: Source) -> None:
        """Write all windows."""
        raise NotImplementedError

    def __len__(self) -> int:
        """Return the number of windows."""
        return self.n

    def loader(self, workers: int) -> Iterable[Sample]:
        """Make a loader of one epoch."""
        return DataLoader(self, BATCH, sampler=EpochSampler(self.n, seed=0), num_workers=workers)


class NpLoad(Peer):
    """A .npy file per array and window, as EDGE reads its features."""

    name = "np.load per sample"

    def write(self, source: Source) -> None:
        """Write all windows."""
        for index in range(len(source)):
            for name in self.fields:
                np.save(self.folder / f"{index}.{name}.npy", source.array(index, name))

    def __getitem__(self, index: int) -> Sample:
        """Read one window."""
        return {name: torch.from_numpy(np.load(self.folder / f"{index}.{name}.npy")) for name in self.fields}


class Memmap(Peer):
    """One array (windows, rows, columns) per field, mapped; samples are views of it."""

    name = "np.memmap"

    def write(self, source: Source) -> None:
        """Write all windows."""
        for name in self.fields:
            first = source.array(0, name)
            out = np.lib.format.open_memmap(
                self.folder / f"{name}.npy", "w+", first.dtype, (len(source), *first.shape)
            )
            for index in range(len(source)):
                out[index] = source.array(index, name)
            out.flush()

    def __getitem__(self, index: int) -> Sample:
        """Read one window; copy-on-write, as torch needs writable arrays."""
        if not hasattr(self, "_maps"):
            self._maps = {name: np.load(self.folder / f"{name}.npy", mmap_mode="c") for name in self.fields}
        return {name: torch.from_numpy(np.asarray(rows[index])) for name, rows in self._maps.items()}


class ChunkedH5(Peer):
    """HDF5 by h5py, one chunk per window, gzip 4."""

    name = "h5py, chunked + gzip"

    def write(self, source: Source) -> None:
        """Write all windows."""
        with h5py.File(self.folder / "windows.h5", "w") as file:
            for name in self.fields:
                first = source.array(0, name)
                shape = (len(source), *first.shape)
                out = file.create_dataset(name, shape, first.dtype, chunks=(1, *first.shape), compression="gzip")
                for index in range(len(source)):
                    out[index] = source.array(index, name)

    def __getitem__(self, index: int) -> Sample:
        """Read one window; the file is opened in each worker."""
        if getattr(self, "_process", None) != os.getpid():
            self._file, self._process = h5py.File(self.folder / "windows.h5", "r"), os.getpid()
        return {name: torch.from_numpy(self._file[name][index]) for name in self.fields}


class Zarr(Peer):
    """zarr, one chunk per window, uncompressed, its fastest configuration."""

    name = "zarr, chunk per window"
    package = "zarr"

    def write(self, source: Source) -> None:
        """Write all windows."""
        import zarr

        for name in self.fields:
            first = source.array(0, name)
            shape, chunks = (len(source), *first.shape), (1, *first.shape)
            path = self.folder / name
            out = zarr.create_array(store=str(path), shape=shape, chunks=chunks, dtype=first.dtype, compressors=None)
            for index in range(len(source)):
                out[index] = source.array(index, name)

    def __getitem__(self, index: int) -> Sample:
        """Read one window; opened in each worker."""
        import zarr

        if getattr(self, "_process", None) != os.getpid():
            self._arrays = {name: zarr.open_array(str(self.folder / name), mode="r") for name in self.fields}
            self._process = os.getpid()
        return {name: torch.from_numpy(rows[index]) for name, rows in self._arrays.items()}


class WebDataset(Peer):
    """Tar files of .npy members, read in order."""

    name = "WebDataset"
    package = "webdataset"
    in_order = True

    def write(self, source: Source) -> None:
        """Write all windows, in 8 shards."""
        import webdataset

        for shard in range(8):
            with webdataset.TarWriter(str(self.folder / f"{shard}.tar")) as out:
                for index in range(shard, len(source), 8):
                    members: dict[str, Any] = {"__key__": f"{index:06d}"}
                    for name in self.fields:
                        buffer = io.BytesIO()
                        np.save(buffer, source.array(index, name))
                        members[f"{name}.npy"] = buffer.getvalue()
                    out.write(members)

    def loader(self, workers: int) -> Iterable[Sample]:
        """Make a loader of one epoch."""
        import webdataset

        urls = [str(self.folder / f"{shard}.tar") for shard in range(8)]
        samples = webdataset.WebDataset(urls, shardshuffle=False).decode().map(self._arrays)
        return DataLoader(samples, BATCH, num_workers=workers)

    def _arrays(self, members: dict[str, Any]) -> Sample:
        return {name: torch.from_numpy(members[f"{name}.npy"]) for name in self.fields}


class LitData(Peer):
    """LitData's chunks of 64 MB, read in order."""

    name = "LitData"
    package = "litdata"
    in_order = True

    def write(self, source: Source) -> None:
        """Write all windows."""
        from litdata.streaming import Cache

        cache = Cache(str(self.folder), chunk_bytes="64MB")
        for index in range(len(source)):
            cache[index] = {name: torch.from_numpy(source.array(index, name)) for name in self.fields}
        cache.done()
        cache.merge()

    def loader(self, workers: int) -> Iterable[Sample]:
        """Make a loader of one epoch."""
        from litdata import StreamingDataLoader, StreamingDataset

        return StreamingDataLoader(StreamingDataset(str(self.folder)), batch_size=BATCH, num_workers=workers)


PEERS: tuple[type[Peer], ...] = (NpLoad, Memmap, ChunkedH5, WebDataset, LitData, Zarr)
