"""What the loaders of Lodge and FineDance ask for: every published id that they do not ignore."""

from dancedata.core.text import counted, listed
from dancedata.datasets.finedance.facts import facts
from dancedata.exports.base.folder import ExportFolder
from dancedata.exports.base.job import ExportJob, Lack
from dancedata.exports.base.needs import needs_field, needs_fps, needs_names, needs_track_scope

FPS = 30


def track_lacks(job: ExportJob, motion: str, feature: str) -> list[Lack]:
    """Return what a dataset lacks for whole tracks of motion and 35 columns of music at 30 per second."""
    lacks = needs_fps(job, FPS) + needs_track_scope(job) + needs_field(job, motion, kind="motion", rate=FPS)
    lacks += needs_field(job, feature, kind="audio", width=35, rate=FPS)
    form = "001 to 211, as FineDance does: dataset: {finedance: {}}; copies (augment) have other names"
    return lacks + needs_names(job.clips(), lambda name: name in facts().ids, form)


def note_missing(job: ExportJob, folder: ExportFolder, ignored: frozenset[str], loader: str) -> None:
    """Note the ids that a loader opens but that are not there: it would end with FileNotFoundError."""
    exported = {clip.id for clip in job.clips()}
    missing = [name for name in facts().ids if name not in ignored and name not in exported]
    if missing:
        folder.note(
            f"{loader} opens every published id but {len(ignored)} ignored ones; {counted(len(missing), 'id')} of "
            "them are not in the dataset, and the unmodified loader ends with FileNotFoundError at the first: "
            f"{listed(missing, 12)}"
        )
