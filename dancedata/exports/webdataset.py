"""Tar shards of windows or clips, as webdataset and other readers of tar streams take them."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.typing import override
from dancedata.exports._samples import SampleExport
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing, field_json, record_json
from dancedata.exports.base.needs import needs_names

if TYPE_CHECKING:
    from dancedata.core.clip import Window
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip

_Member = tuple[str, bytes]


@EXPORTS.register("webdataset")
@dataclass(frozen=True)
class WebDataset(SampleExport):
    """<split>-000000.tar, ...: samples of one .npy per field and one .json, by the key before the first point.

    Attributes
    ----------
    seed
        Samples are shuffled within each split, as readers of streams shuffle only within a buffer; below 0: they keep
        the dataset's order.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}}
    reference: ClassVar[str] = "webdataset (github.com/webdataset/webdataset)"

    seed: int = 0

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        return super().missing(job) + needs_names(
            job.clips(), lambda name: "." not in name, "without points: a key ends at the first"
        )

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        index: dict[str, int] = {}
        for split in job.store.splits:
            clips: list[tuple[Clip, Window | None]] = [(clip, None) for clip in job.clips(split)]
            samples = clips if self.samples == "clips" else self.table(job).samples(split)
            index |= self._shards(job, folder, split, samples)
        fields = {name: field_json(job, name) for name in self.reads(job)}
        folder.write_json("index.json", {"shards": index, "fields": fields})

    @override
    def guide(self, job: ExportJob) -> str:
        name = self.reads(job)[0]
        split = job.store.splits[0]
        return (
            f"Samples are {self.samples}; `index.json` has the number in each shard, and columns, rates and scalers "
            "of the fields. Rows are not normalised.\n\n"
            "```python\nimport webdataset as wds\n\n"
            f'train = wds.WebDataset("{split}-000000.tar", shardshuffle=False).shuffle(1000).decode()\n'
            f'for sample in train:\n    rows = sample["{_suffix(name)}"]  # (L, D) numpy\n'
            '    about = sample["json"]  # clip, first frame, genre, ...\n```\n\n'
            "With several shards: `train-{000000..000007}.tar` and `shardshuffle=100`. A worker takes whole shards: "
            "have at least as many shards as workers and ranks.\n"
        )

    def _shards(
        self, job: ExportJob, folder: AtomicFolder, split: str, samples: list[tuple[Clip, Window | None]]
    ) -> dict[str, int]:
        if self.seed >= 0:
            order = np.random.default_rng(self.seed).permutation(len(samples)).tolist()
            samples = [samples[k] for k in order]
        left = iter(job.each(f"samples of {split}", samples))
        counts: dict[str, int] = {}
        pending = next(left, None)
        while pending is not None:
            name, size, count = f"{split}-{len(counts):06d}.tar", 0, 0
            with (
                folder.open_file(name) as file,
                tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar,
            ):
                while pending is not None and (count == 0 or size < self.shard_mb * 2**20):
                    size += _add(tar, self._members(job, *pending))
                    count, pending = count + 1, next(left, None)
            counts[name] = count
        return counts

    def _members(self, job: ExportJob, clip: Clip, window: Window | None) -> Iterator[_Member]:
        key = clip.id if window is None else f"{clip.id}_{window.start:06d}"
        for name in self.reads(job):
            rows = clip.read(name) if window is None else job.store.read(window, name)
            yield f"{key}.{_suffix(name)}", _npy(rows)
        attributes = record_json(clip)
        if window is not None:
            attributes |= {"start": window.start, "frames": window.length}
        yield (
            f"{key}.json",
            json.dumps(attributes, ensure_ascii=False, allow_nan=False).encode("utf-8", "backslashreplace"),
        )


def _suffix(field: str) -> str:
    """Return the suffix after the key of a sample, without a second point for an instance such as librosa35.60."""
    return f"{field.replace('.', '-')}.npy"


def _npy(rows: npt.NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(rows), allow_pickle=False)
    return buffer.getvalue()


def _add(tar: tarfile.TarFile, members: Iterator[_Member]) -> int:
    """Add files without owner and time, so that equal samples give equal bytes; return their size."""
    size = 0
    for name, data in members:
        info = tarfile.TarInfo(name)
        info.size = len(data)
        tar.addfile(info, io.BytesIO(data))
        size += len(data)
    return size
