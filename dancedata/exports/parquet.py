"""Parquet files, as pandas, polars, DuckDB and Hugging Face's datasets read them."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.packages import require
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.exports._samples import SampleExport, SampleTable, require_size
from dancedata.exports.base.job import EXPORTS, ExportJob, field_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dancedata.exports._samples import Sample
    from dancedata.files.atomic_folder import AtomicFolder


@EXPORTS.register("parquet")
@dataclass(frozen=True)
class Parquet(SampleExport):
    """data/<split>-00000-of-00001.parquet, ...: a row per window or clip, a column per field; README.md is a card.

    Attributes
    ----------
    row_group_mb
        Size of the fields of a row group in MiB, before compression: what a reader decodes at once, and the memory
        that writing takes.
    """

    reference: ClassVar[str] = "Apache Parquet (parquet.apache.org)"

    row_group_mb: float = 16

    def __post_init__(self) -> None:
        super().__post_init__()
        require_size(self, "row_group_mb")

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        from dancedata.formats.hub_head import unnamed_splits  # reads HDF5, which listing plug-ins need not

        require("parquet", what="--to parquet")
        table, rows = self.table(job), dict[str, int]()
        for split in job.store.splits:
            shards = table.shards(split, self.shard_mb)
            for k, samples in enumerate(job.each(f"files of {split}", shards)):
                name = f"data/{split}-{k:05d}-of-{len(shards):05d}.parquet"
                with folder.open_file(name) as file:
                    self._write_rows(table, file, samples)
                rows[name] = len(samples)
        self._write_index(job, folder, rows)
        unnamed = unnamed_splits(job.store.splits)
        if unnamed:
            folder.note(
                f"datasets takes no split with this name: {listed(unnamed)}; name the files, as in "
                'load_dataset("parquet", data_files={"train": "data/NAME-*.parquet"})'
            )

    @override
    def head(self, job: ExportJob) -> str:
        from dancedata.formats.hub_head import head, unnamed_splits

        splits = [split for split in job.store.splits if split not in unnamed_splits(job.store.splits)]
        return head(job.store, splits, {"default": "data/{}-*.parquet"}, viewer=True)

    @override
    def guide(self, job: ExportJob) -> str:
        split, field, first = job.store.splits[0], self.table(job).fields[0], next(iter(self.table(job).facts))
        width = job.store.field(field).columns.width
        return (
            f"A row is one of the {self.samples}. Columns of {field} and other fields hold its rows, not normalised; "
            "`index.json` has the name of every column of a field, its rate, axes, statistics and scaler.\n\n"
            "```python\nfrom datasets import load_dataset\n\n"
            f'{split} = load_dataset("parquet", data_files="data/{split}-*.parquet", split="train")\n'
            f'rows = {split}.with_format("numpy")[0]["{field}"]  # (L, {width})\n```\n\n'
            "```python\nimport pyarrow.parquet as pq\n\n"
            f'file = pq.ParquetFile("data/{split}-00000-of-00001.parquet")\n'
            f'for batch in file.iter_batches(64, columns=["{first}", "{field}"]):\n'
            "    print(batch.num_rows)\n```\n"
        )

    def _write_index(self, job: ExportJob, folder: AtomicFolder, rows: Mapping[str, int]) -> None:
        store, statistics = job.store, job.store.stats.get("fields", {})
        fields = {
            name: field_json(job, name, axes=store.field(name).axes, statistics=statistics.get(name))
            for name in self.table(job).fields
        }
        entry = {"layout": 1, "samples": self.samples, "fps": str(store.grid), "skeleton": store.skeleton.to_json()}
        folder.write_json("index.json", {**entry, "rows": dict(rows), "fields": fields})

    def _write_rows(self, table: SampleTable, file: Any, samples: Sequence[Sample]) -> None:
        writer: Any = import_module("pyarrow.parquet").ParquetWriter(
            file,
            table.schema,
            compression="zstd",
            use_dictionary=list(table.facts),  # numbers of fields hardly repeat, but their high bytes do
            use_byte_stream_split=[f"{field}.list.element.list.element" for field in table.fields],
            store_schema=True,  # lists of fixed size are read back as such
        )
        with writer:
            for batch in table.batches(samples, self.row_group_mb):
                writer.write_batch(batch, row_group_size=batch.num_rows)
