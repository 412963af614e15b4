"""What exports of FineDance share: its ids, whole tracks, and the ids that loaders open."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.resources import manifest
from dancedata.core.text import counted, listed
from dancedata.exports.base.job import ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_fps, needs_music_from_start, needs_names

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder

_FPS = 30
#: The published sequences.
IDS = tuple(f"{n:03d}" for n in range(1, 212))


def needs_tracks(job: ExportJob, motion: str, feature: str) -> list[Missing]:
    """Check that a dataset has whole tracks of motion and 35 columns of music at 30 per second."""
    missing = needs_fps(job, _FPS) + needs_field(job, motion, kind="motion", rate=_FPS)
    missing += needs_field(job, feature, kind="audio", width=35, rate=_FPS)
    form = "001 to 211, as FineDance does: dataset: {finedance: {}}; copies (augment) have other names"
    missing += needs_music_from_start(job.clips())
    return missing + needs_names(job.clips(), lambda name: name in IDS, form)


def note_missing(job: ExportJob, folder: AtomicFolder, loader: str, *ignore_lists: str) -> None:
    """Note the ids that a loader opens but that are missing: it would end with FileNotFoundError."""
    lists = manifest("finedance")["ignore_lists"]
    ignored = {name for of in ignore_lists for name in lists[of]["ids"]}
    exported = {clip.id for clip in job.clips()}
    missing = [name for name in IDS if name not in ignored and name not in exported]
    if missing:
        folder.note(
            f"{loader} opens every published id but {len(ignored)} ignored ones; {counted(len(missing), 'id')} of "
            "them are not in the dataset, and the unmodified loader ends with FileNotFoundError at the first: "
            f"{listed(missing, 12)}"
        )
