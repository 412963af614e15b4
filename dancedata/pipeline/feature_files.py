"""Audio fields whose rows come from files: their files, places on clips, and rows as units of work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from dancedata.audio.file import FileRows, Placed
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.execution.cache import Cache, CachedArray
from dancedata.files.regular_file import sha256_file
from dancedata.pipeline.rejects import BUILD_AGAIN, CHANGED, attempt, reject_of
from dancedata.recipes.fields import FeatureJob

if TYPE_CHECKING:
    from dancedata.recipes.recipe import Recipe

#: Raised by hand when the stage gives other numbers for the same input.
_STAGE = 1


@dataclass(frozen=True)
class FeatureFile:
    """A file with the rows of a field; `sha256` is "" where a plan has not read it."""

    path: Path
    sha256: str
    n_rows: int


def with_feature_paths(recipe: Recipe, ref: ClipRef, source: Path) -> ClipRef:
    """Return a clip with the files of the recipe's fields."""
    paths = [(job.name, feature_of(job).file_of(ref, source)) for job in recipe.file_jobs]
    return replace(ref, feature_paths=tuple((name, path) for name, path in paths if path is not None))


def feature_of(job: FeatureJob) -> FileRows:
    """Return the feature of a field whose rows come from files."""
    if not isinstance(job.feature, FileRows):
        raise UsageError("a feature without files was taken for one with files", where=job.name)
    return job.feature


def length_of(job: FeatureJob, ref: ClipRef) -> FeatureFile | Reject:
    """Return a clip's file of a field by its header, or its reject; nothing is hashed."""
    path = dict(ref.feature_paths).get(job.name)
    if path is None or not path.is_file():
        what = f"no file {path}" if path is not None else f"the clip has no name for {feature_of(job).path}"
        fix = f"set audio.{job.name}.path, which is below the source, or leave the field out"
        return Reject("missing_feature", ref.id, str(path or ""), detail=f"field {job.name}: {what}", fix=fix)
    n_rows = attempt(lambda: feature_of(job).length(path), path, ref.id)
    return n_rows if isinstance(n_rows, Reject) else FeatureFile(path, "", n_rows)


def identify_files(cache: Cache, recipe: Recipe, ref: ClipRef) -> dict[str, FeatureFile] | Reject:
    """Return a clip's file of each field that has files, hashed; or the reject of the first that cannot be used."""
    files = {}
    for job in recipe.file_jobs:
        file = length_of(job, ref)
        if isinstance(file, Reject):
            return file
        try:
            files[job.name] = replace(file, sha256=cache.file_sha256(file.path))
        except OSError as error:
            return Reject("broken_file", ref.id, str(file.path), detail=f"{file.path}: {error}")
    return files


def place(job: FeatureJob, ref: ClipRef, n_rows: int) -> Placed:
    """Place a file on a clip's frames; DataError as `FileRows.placed`."""
    feature = feature_of(job)
    return feature.placed(n_rows, feature.begin_s(ref.audio_start), job.grid)


def _n_rows(job: FeatureJob, ref: ClipRef, file: FeatureFile) -> int:
    """Return the rows of a file on the clip's grid, from frame 0 on."""
    placed = place(job, ref, file.n_rows)
    return placed.first + placed.n_rows


def frames_within(
    recipe: Recipe, ref: ClipRef, files: Mapping[str, FeatureFile], n_frames: int, rate: Fraction
) -> tuple[int, int] | Reject:
    """Return the frames [first, end) of the recipe's grid that all files reach.

    `n_frames`, `rate`: Length and rate of the clip's motion in its source.
    Returns: ``feature_length`` where a file's length differs from the motion's by more than the field's tolerance;
        ``between_rows``.
    """
    first, ends = 0, []
    for job in recipe.file_jobs:
        feature, file = feature_of(job), files[job.name]
        file_s, motion_s = feature.grid.seconds(file.n_rows), FrameGrid(rate).seconds(n_frames)
        tolerance = None if feature.tolerance_s is None else Fraction(feature.tolerance_s)
        frames = FrameGrid(rate).resampled_length(n_frames, recipe.grid)
        # Rows of motion reach into the last row of the clip, whatever the tolerance; codes end with the pad.
        is_real_motion = feature.of_motion and feature.codebook is None
        is_short = is_real_motion and recipe.grid.rows_down(frames, of=job.grid) > _n_rows(job, ref, file)
        if is_short or (tolerance is not None and abs(file_s - motion_s) > tolerance):
            seconds = {"feature_s": round(float(file_s), 3), "motion_s": round(float(motion_s), 3)}
            detail = f"field {job.name}: {file.path} has {file.n_rows} rows, {float(file_s):.3f} s; the motion has "
            detail += f"{float(motion_s):.3f} s; the tolerance is {feature.tolerance_s} s"
            if is_short:
                detail += "; rows of motion last as long as it, or the field is of: music"
            fix = f"check audio.{job.name}.rate; set tolerance_s if the difference is known, null for whole songs"
            return Reject("feature_length", ref.id, str(file.path), detail=detail, numbers=seconds, fix=fix)
        try:
            placed = place(job, ref, file.n_rows)
        except DataError as error:
            return reject_of(error, ref.id, file.path)
        first = max(first, job.grid.rows_up(placed.first, of=recipe.grid))
        ends.append(job.grid.rows_down(placed.first + placed.n_rows, of=recipe.grid))
    return first, min(ends)


def starts_within(
    recipe: Recipe,
    ref: ClipRef,
    files: Mapping[str, FeatureFile],
    starts: Sequence[int],
    motion: tuple[int, Fraction],
) -> tuple[tuple[int, ...], list[Reject]]:
    """Return the starts of windows that all files reach, and a reject for each of the others.

    `motion` is the length and rate of the clip's motion in its source. The clip is left out, with a reject, if none
    is left.
    """
    if not recipe.file_jobs or not starts:
        return tuple(starts), []
    reached = frames_within(recipe, ref, files, *motion)
    if isinstance(reached, Reject):
        return (), [reached]
    first, end = reached
    kept = tuple(start for start in starts if start >= first and start + recipe.windows.length <= end)
    detail = f"the files of {' and '.join(job.name for job in recipe.file_jobs)} reach from frame {first} to {end}"
    if not kept:
        return (), [Reject("short_feature", ref.id, detail=f"{detail}: no window of the clip lies within")]
    left = [start for start in starts if start not in kept]
    return kept, [Reject("no_audio", ref.id, "", start, f"the window at frame {start}: {detail}") for start in left]


def file_key(job: FeatureJob, sha256: str, placed: Placed) -> str:
    """Return the cache key of a file's rows on a clip's grid: of its content, not its name."""
    feature = feature_of(job)
    return Cache.key(
        "feature file",
        version=[_STAGE, feature.version],
        file=sha256,
        rate=feature.rate,
        fps=str(job.grid),
        phase=str(placed.phase),
        resample=feature.resample,
        dtype=feature.dtype,
        # Only where there are any, so that keys of real values stay.
        **({} if feature.codebook is None else {"codes": [feature.codebook.to_json(), list(feature.first_codes)]}),
    )


def extract_file(cache: Cache, job: FeatureJob, file: FeatureFile, placed: Placed, key: str) -> CachedArray | Reject:
    """Read and resample a file's rows, and publish them under `key`."""

    def rows() -> npt.NDArray[Any]:
        found = feature_of(job).rows(file.path, placed)
        if sha256_file(file.path) != file.sha256:
            raise DataError(CHANGED, reason="changed", where=file.path, fix=BUILD_AGAIN)
        return found

    try:
        return cache.once("features", key, rows)
    except DataError as error:
        return reject_of(error, file=file.path)
    except OSError as error:
        return Reject("broken_file", file=str(file.path), detail=f"{file.path}: {error}")
