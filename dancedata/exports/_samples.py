"""Windows or clips as samples; as Arrow tables, a row each, in batches of bounded size."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.exports.base.job import Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_fields, needs_music_from_start

if TYPE_CHECKING:
    from types import ModuleType

    from dancedata.core.clip import Window
    from dancedata.kernel import Clip, Field

    Sample = tuple[Clip, Window | None]

#: Arrow types of columns by the type in tables.
_TYPES = {"text": "string", "int": "int64", "int32": "int64", "float": "float64", "bool": "bool_"}
_LISTS = {"texts": "string", "ints": "int64", "floats": "float64"}
#: Columns that the tables of pandas have as another type than the dataset: seconds as numbers, terms as text.
_SHOWN = {"source_start": "float", "source_end": "float", "audio_start": "float", "licence": "text"}
#: Of whole clips; a window has other ones.
_OF_CLIPS = ("id", "split", "seconds", "n_frames")
_MIB = 1 << 20


@dataclass(frozen=True)
class SampleTable:
    """Samples as rows: the columns of `Store.to_pandas`, and one per field.

    A field of windows is a fixed-size list of L rows of D values, one of clips (`whole`) a list of rows of D values.
    """

    job: ExportJob
    fields: tuple[str, ...]
    whole: bool

    @cached_property
    def schema(self) -> Any:
        """The Arrow schema; its metadata hold the dataset's name and terms, and the columns of the fields."""
        pa, store = import_module("pyarrow"), self.job.store
        rows = [pa.field(name, _type(pa, kind)) for name, kind in self.facts.items()]
        rows += [pa.field(name, self._rows_type(pa, store.field(name))) for name in self.fields]
        about = {
            "name": str(store.info.get("name", "")),
            "licence": store.info.get("licence"),
            "citation": store.info.get("citation"),
            "fps": str(store.grid),
            "fields": {
                name: {k: v for k, v in store.field(name).to_json().items() if k != "name"} for name in self.fields
            },
        }
        return pa.schema(rows, metadata={"dancedata": json.dumps(about, ensure_ascii=False)})

    @cached_property
    def facts(self) -> dict[str, str]:
        """Types of the columns that are not fields, by name."""
        from dancedata.kernel import CLIP_COLUMNS

        kinds = {"id": "text", "split": "text", "seconds": "float"}
        kinds |= {c.name: c.kind for c in CLIP_COLUMNS} | _SHOWN
        kinds |= self.job.store.free_types
        if self.whole:
            return kinds
        of_windows = {"clip": "text", "split": "text", "start": "int", "length": "int"}
        of_windows |= {"start_s": "float", "length_s": "float"}
        return of_windows | {name: kind for name, kind in kinds.items() if name not in _OF_CLIPS}

    def shards(self, split: str, shard_mb: float) -> list[list[Sample]]:
        """Return the samples of a split in stored order, in parts whose fields have up to about `shard_mb` MiB."""
        return list(self._parts(self.samples(split), shard_mb * _MIB))

    def batches(self, samples: Sequence[Sample], batch_mb: float) -> Iterator[Any]:
        """Yield record batches whose fields have up to about `batch_mb` MiB, or one sample."""
        for part in self._parts(samples, batch_mb * _MIB):
            yield self._batch(part)

    def samples(self, split: str) -> list[Sample]:
        """Return the samples of a split in stored order."""
        left_out = self.job.without
        clips = {c.id: c for c in self.job.store.clips() if c.split == split and c.id not in left_out}
        if self.whole:
            return [(clip, None) for clip in clips.values()]
        return [(clips[window.clip], window) for window in self.job.store.windows(split, fields=self.fields)]

    def _parts(self, samples: Sequence[Sample], size: float) -> Iterator[list[Sample]]:
        part: list[Sample] = []
        n_bytes = 0
        for sample in samples:
            n_bytes += self._size(*sample)
            if part and n_bytes > size:
                yield part
                part, n_bytes = [], self._size(*sample)
            part.append(sample)
        if part:
            yield part

    def _size(self, clip: Clip, window: Window | None) -> int:
        frames = clip.n_frames if window is None else window.length
        grid, fields = self.job.store.grid, map(self.job.store.field, self.fields)
        return sum(grid.rows_up(frames, of=field.grid) * field.row_bytes for field in fields)

    def _batch(self, samples: Sequence[Sample]) -> Any:
        pa, store = import_module("pyarrow"), self.job.store
        of_clips = {clip.id: store.table_row(clip) for clip, _ in samples}
        facts = [of_clips[clip.id] | ({} if window is None else store.table_row(window)) for clip, window in samples]
        arrays = [pa.array([row[n] for row in facts], self.schema.field(n).type) for n in self.facts]
        arrays += [self._column(pa, store.field(name), samples) for name in self.fields]
        return pa.record_batch(arrays, schema=self.schema)

    def _column(self, pa: ModuleType, field: Field, samples: Sequence[Sample]) -> Any:
        """Return the rows of a field: the values as one array, and where each sample and each row of it begins."""
        rows = [self._read(field, *sample) for sample in samples]
        joined = np.concatenate(rows) if len(rows) > 1 else rows[0]
        cells = pa.FixedSizeListArray.from_arrays(pa.array(joined.reshape(-1)), field.columns.width)
        if not self.whole:
            return pa.FixedSizeListArray.from_arrays(cells, len(rows[0]))
        return pa.ListArray.from_arrays(pa.array(np.cumsum([0, *map(len, rows)]), pa.int32()), cells)

    def _read(self, field: Field, clip: Clip, window: Window | None) -> np.ndarray[Any, Any]:
        return clip.read(field.name) if window is None else self.job.store.read(window, field.name)

    def _rows_type(self, pa: ModuleType, field: Field) -> Any:
        row = pa.list_(getattr(pa, field.dtype)(), field.columns.width)
        if self.whole:
            return pa.list_(row)
        return pa.list_(row, self.job.store.grid.rows(self.job.store.info["windows"]["length"], of=field.grid))


def _type(pa: ModuleType, kind: str) -> Any:
    return pa.list_(getattr(pa, _LISTS[kind])()) if kind in _LISTS else getattr(pa, _TYPES[kind])()


def require_size(target: Export, key: str) -> None:
    """Raise UsageError unless a key of an export is a size in MiB."""
    size = getattr(target, key)
    if not 0 < size <= _MIB:
        allowed = f"MiB above 0, up to {_MIB}"
        raise UsageError(f"{target.name}: invalid value for {key}", found=size, allowed=allowed)


@dataclass(frozen=True)
class SampleExport(Export):
    """The keys of exports of samples, and what they need.

    Attributes
    ----------
    samples
        ``windows``: those of the dataset. ``clips``: whole clips.
    fields
        Names of the fields to write. Default: all.
    shard_mb
        Size of the fields of a file in MiB, before compression; a sample is never split.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}, "audio": {"librosa35": {}}}

    samples: Literal["windows", "clips"] = "windows"
    fields: tuple[str, ...] = ()
    shard_mb: float = 256

    def __post_init__(self) -> None:
        require_size(self, "shard_mb")

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_fields(job, self.fields)
        if len(set(self.fields)) < len(self.fields):
            missing.append(Missing("fields has a name twice", "name each once"))
        taken = [name for name in self.table(job).fields if name in self.table(job).facts]
        if taken:
            others = [name for name in job.store.fields if name not in taken]
            fix = f"name the other fields, {listed(others)}; or build with another name, such as {taken[0]}.rows"
            missing.append(Missing(f"a field has the name of a column of facts: {listed(taken)}", fix))
        if self.samples == "clips":
            missing += needs_music_from_start(job.clips())
        return missing

    @override
    def reads(self, job: ExportJob) -> tuple[str, ...]:
        return self.fields or tuple(job.store.fields)

    def table(self, job: ExportJob) -> SampleTable:
        """Return the samples."""
        return SampleTable(job, self.fields or tuple(job.store.fields), self.samples == "clips")
