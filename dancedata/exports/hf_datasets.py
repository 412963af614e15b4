"""A folder that load_from_disk of Hugging Face's datasets opens: Arrow files that are mapped, not read."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.hashing import json_sha256
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.exports._samples import SampleExport, SampleTable
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.files.documents import document_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dancedata.exports._samples import Sample
    from dancedata.files.atomic_folder import AtomicFolder

#: MiB of fields of a record batch.
_BATCH_MB = 16


@EXPORTS.register("hf-datasets")
@dataclass(frozen=True)
class HfDatasets(SampleExport):
    """A DatasetDict as save_to_disk writes it: a row per window or clip, a column per field."""

    reference: ClassVar[str] = "datasets (github.com/huggingface/datasets)"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        from dancedata.formats.hub_head import unnamed_splits  # reads HDF5, which listing plug-ins need not

        missing, unnamed = super().missing(job), unnamed_splits(job.store.splits)
        if unnamed:
            problem = f"datasets takes no split with this name: {listed(unnamed)}"
            missing.append(Missing(problem, "names of splits of letters, digits and _, or --to parquet"))
        return missing

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        rows = self.write_shards(job, folder, "{split}/data-{k:05d}-of-{n:05d}.arrow", _write_rows)
        for split in job.store.splits:
            names = [name.partition("/")[2] for name in rows if name.startswith(f"{split}/")]
            folder.write_json(f"{split}/state.json", self._state(job, split, names))
            folder.write_json(f"{split}/dataset_info.json", _info(job))
        folder.write_json("dataset_dict.json", {"splits": list(job.store.splits)})

    @override
    def guide(self, job: ExportJob) -> str:
        split, field = job.store.splits[0], self.table(job).fields[0]
        return self.guide_rows(job) + (
            "```python\nfrom datasets import load_from_disk\n\n"
            f'{split} = load_from_disk(".")["{split}"].with_format("torch")\n'
            f'rows = {split}[0]["{field}"]  # (L, {job.store.field(field).columns.width})\n```\n'
        )

    def _state(self, job: ExportJob, split: str, names: Sequence[str]) -> dict[str, Any]:
        """Return state.json; equal exports have one fingerprint, by which datasets caches what is made of them."""
        of = [job.store.info.get("self_sha256"), document_of(self), self.version, split]
        return {
            "_data_files": [{"filename": name} for name in names],
            "_fingerprint": json_sha256(of)[:16],
            "_format_columns": None,
            "_format_kwargs": {},
            "_format_type": None,
            "_output_all_columns": False,
            "_split": split,
        }


def _info(job: ExportJob) -> dict[str, Any]:
    """Return dataset_info.json without features, whose form differs by version: the schema of the files has them."""
    meta = job.store.info
    texts = {"citation": meta.get("citation"), "license": meta.get("licence")}
    return {"description": str(meta.get("name", "")), **{key: str(text or "") for key, text in texts.items()}}


def _write_rows(table: SampleTable, file: Any, samples: Sequence[Sample]) -> None:
    with import_module("pyarrow").ipc.new_stream(file, table.schema) as writer:
        for batch in table.batches(samples, _BATCH_MB):
            writer.write_batch(batch)
