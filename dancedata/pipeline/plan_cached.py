"""The units of work of a plan that are in the cache already. Opens no source file."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import SourceError, UsageError
from dancedata.execution.cache import Cache
from dancedata.pipeline.audio import FeatureKeys, known_signal, timeline_of
from dancedata.pipeline.feature_files import file_key, length_of, place
from dancedata.pipeline.groups import groups_of
from dancedata.pipeline.motion_keys import MotionKeys, content_hashes
from dancedata.recipes.copies import is_copied
from dancedata.recipes.fields import FeatureJob
from dancedata.recipes.recipe import Recipe


@dataclass(frozen=True)
class Cached:
    """The number of a field's units of work, and of those in the cache.

    `unit`: "clips" for motion, with copies that are encoded; "songs" or "windows" for audio, by scope. Equal units
        count once if a build has read their files before; units of other files count each.
    """

    unit: str
    cached: int
    of: int

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {"unit": self.unit, "cached": self.cached, "of": self.of}


def cached_units(
    cache: Cache,
    recipe: Recipe,
    scanned: Sequence[ClipRef],
    clips: Sequence[tuple[ClipRef, int]],
    retimed: Sequence[tuple[ClipRef, int, Fraction]],
) -> dict[str, Cached]:
    """Return the cached units of each field.

    `scanned` are the clips of the source, `clips` those that a build would keep, with their number of windows;
    `retimed` the same of their copies at another speed, with the speed. A file is recognised by its path, size, time
    of change and inode. A file that no build has read counts as not cached, although a copy of it may have been
    computed.
    """
    units = _motion(cache, recipe, scanned, [ref for ref, _ in clips])
    signals = {path: known_signal(cache, path) for path in {r.audio_path for r, _ in clips} if path is not None}
    for job in recipe.file_jobs:
        units[job.name] = _files(cache, job, [ref for ref, _ in clips])
    for job in recipe.signal_jobs:
        units[job.name] = _audio(cache, job, [*((ref, n, Fraction(1)) for ref, n in clips), *retimed], signals)
    return units


def _motion(cache: Cache, recipe: Recipe, scanned: Sequence[ClipRef], refs: Sequence[ClipRef]) -> dict[str, Cached]:
    names = [clip_field.name for clip_field in recipe.clip_fields]
    counts = dict.fromkeys(names, 0)
    encoded = [spec for spec in recipe.augment if spec.augmentation.changes != "rows"]
    of = len(refs) + len(encoded) * sum(is_copied(ref.split) for ref in refs)
    try:
        content = content_hashes(recipe.dataset, _known(cache))
    except _UnknownError:
        # A body model that no build has read.
        return {name: Cached("clips", 0, of) for name in names}
    for spec in (None, *encoded):
        motion_keys = MotionKeys(recipe, content, spec)
        of_spec = refs if spec is None else [ref for ref in refs if is_copied(ref.split)]
        # Copies are made of the dancers that are stored.
        groups = groups_of(scanned if spec is None else of_spec, lambda ref: ref)
        for ref in of_spec:
            for name in _fields_held(cache, motion_keys, ref, groups.get(ref.group, ())):
                counts[name] += 1
    return {name: Cached("clips", counts[name], of) for name in names}


def _fields_held(cache: Cache, motion_keys: MotionKeys, ref: ClipRef, group: Sequence[ClipRef]) -> list[str]:
    """Return the fields of a clip that a build would not compute; `group` are the dancers of its group."""
    hashes = {path: cache.known_sha256(path) for path in {ref.motion_path, *(other.motion_path for other in group)}}
    read = {path: sha256 for path, sha256 in hashes.items() if sha256 is not None}
    if len(read) < len(hashes):
        return []
    keys = motion_keys.of(ref, read[ref.motion_path], [(other, read[other.motion_path]) for other in group])
    if not cache.contains("clips", keys.info, "json"):
        return []
    return [name for name, key in keys.fields.items() if cache.contains("motion", key)]


def _audio(
    cache: Cache,
    job: FeatureJob,
    clips: Sequence[tuple[ClipRef, int, Fraction]],
    signals: dict[Path, Any],
) -> Cached:
    unit = "songs" if job.windows is None else "windows"
    ready = _resolved(cache, job)
    counted: set[str] = set()
    unknown: set[tuple[Any, ...]] = set()
    keys = None if ready is None else FeatureKeys(ready)
    for ref, n_windows, speed in clips:
        signal = None if ref.audio_path is None else signals[ref.audio_path]
        bpm = ref.tempo_bpm if ref.tempo_bpm is None else float(Fraction(ref.tempo_bpm) * speed)
        numbers = [0] if job.windows is None else range(n_windows)
        if signal is None or keys is None:
            unknown.update((ref.audio_path, bpm, speed, number) for number in numbers)
        elif job.windows is None:
            timeline, _ = timeline_of(signal.at_speed(speed), ref.audio_start / speed, job.grid)
            counted.add(keys.track(bpm, timeline.sha256))
        else:
            counted.update(keys.window(bpm, signal.at_speed(speed), number) for number in numbers)
    return Cached(unit, sum(cache.contains("features", key) for key in counted), len(counted) + len(unknown))


def _files(cache: Cache, job: FeatureJob, refs: Sequence[ClipRef]) -> Cached:
    keys: set[str] = set()
    unknown: set[Path] = set()
    for ref in refs:
        file = length_of(job, ref)
        if isinstance(file, Reject):
            continue
        sha256 = cache.known_sha256(file.path)
        if sha256 is None:
            unknown.add(file.path)
        else:
            keys.add(file_key(job, sha256, place(job, ref, file.n_rows)))
    return Cached("files", sum(cache.contains("features", key) for key in keys), len(keys) + len(unknown))


def _resolved(cache: Cache, job: FeatureJob) -> FeatureJob | None:
    """Return a field as a build computes it; None if that depends on weights that were not read before."""
    # ImportError: a login node that plans, without the packages that compute.
    with suppress(_UnknownError, UsageError, SourceError, ImportError):
        return replace(job, feature=job.feature.resolved(_known(cache)))
    return None


def not_ready(job: FeatureJob) -> str:
    """Return the error of a build with this field on this machine, such as missing weights; "" without one."""

    def unread(path: Path) -> str:
        path.stat()
        raise _UnknownError  # there are weights: a build reads them, a plan does not

    try:
        job.feature.resolved(unread)
    except (UsageError, SourceError, OSError) as error:
        return str(error)
    except (_UnknownError, ImportError):
        pass
    return ""


class _UnknownError(Exception):
    pass


def _known(cache: Cache) -> Callable[[Path], str]:
    def sha256(path: Path) -> str:
        sha256 = cache.known_sha256(path)
        if sha256 is None:
            raise _UnknownError
        return sha256

    return sha256
