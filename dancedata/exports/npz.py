"""A folder of .npz files and one JSON file, for any program that reads numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.typing import override
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing, field_json, record_json
from dancedata.exports.base.needs import needs_fields, needs_music, needs_music_from_start

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip

#: Layout of index.json.
LAYOUT = 1


@EXPORTS.register("npz")
@dataclass(frozen=True)
class Npz(Export):
    """One .npz per clip with an array per field, and index.json with columns, rates, clips, windows and scalers.

    Attributes
    ----------
    fields
        Names of the fields to write. Default: all.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}, "audio": {"librosa35": {}}}

    fields: tuple[str, ...] = ()

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        absent = needs_fields(job, self.fields)
        if not absent and any(job.store.field(name).kind == "audio" for name in self.reads(job)):
            absent += needs_music_from_start(job.clips())
        return absent + (needs_music(job, job.clips()) if job.source is not None else [])

    @override
    def reads(self, job: ExportJob) -> tuple[str, ...]:
        return self.fields or tuple(job.store.fields)

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        clips = {clip.id: self._write_clip(job, clip, folder) for clip in job.each("clips", job.clips())}
        if job.source is not None:
            for clip, name in _copy_music(job, folder).items():
                clips[clip]["music_file"] = name
        folder.write_json("index.json", self._index(job, clips))

    @override
    def guide(self, job: ExportJob) -> str:
        clip, field = job.clips()[0].id, self.reads(job)[0]
        return (
            "```python\nimport json, numpy as np\n\n"
            'index = json.load(open("index.json"))\n'
            f'rows = np.load("clips/{clip}.npz")["{field}"]  # (T, D), not normalised\n```\n\n'
            "`index.json` has the columns, rate and axes of each field, the attributes of each clip, the windows "
            "of each split as [clip, first frame, frames], and the extremes of each column over train windows.\n"
        )

    def _write_clip(self, job: ExportJob, clip: Clip, folder: AtomicFolder) -> dict[str, Any]:
        file = f"clips/{clip.id}.npz"
        folder.write_npz(file, {name: clip.read(name) for name in self.reads(job)})
        return {**record_json(clip), "file": file}

    def _index(self, job: ExportJob, clips: Mapping[str, Any]) -> dict[str, Any]:
        store = job.store
        axes = {name: store.field(name).axes for name in store.fields}
        fields = {name: field_json(job, name, axes=axes.get(name)) for name in self.reads(job)}
        windows = {
            split: [[w.clip, w.start, w.length] for w in store.windows(split, fields=self.reads(job))]
            for split in store.splits
        }
        entry = {"layout": LAYOUT, "fps": str(store.grid), "skeleton": store.skeleton.to_json()}
        return {**entry, "fields": fields, "clips": clips, "windows": windows}


def _copy_music(job: ExportJob, folder: AtomicFolder) -> dict[str, str]:
    """Copy each audio file once; return its name by clip. DataError if one is not the dataset's music."""
    names: dict[Path, str] = {}
    copied: set[tuple[Path, str | None]] = set()
    for clip in job.each("music", job.clips()):
        path = job.music.files[clip.id]
        song = path, job.music.hashes.get(clip.source or clip.id)
        if song not in copied:
            job.music.load(clip)
            copied.add(song)
        if path not in names:
            name = f"music/{path.name}"
            names[path] = name if name not in names.values() else f"music/{clip.id}{path.suffix}"
            folder.copy_file(names[path], path)
    return {clip.id: names[job.music.files[clip.id]] for clip in job.clips()}
