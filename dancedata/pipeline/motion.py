"""Units of work on motion: functions that worker processes run. Each takes and returns small, picklable things."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX52
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.quality import Flag, quality_flags
from dancedata.execution.cache import Cache, CachedArray
from dancedata.files.regular_file import sha256_file
from dancedata.pipeline.groups import group_motions, unusable_dancers
from dancedata.pipeline.motion_keys import ClipKeys, content_hashes
from dancedata.pipeline.rejects import BUILD_AGAIN, CHANGED, reject_of
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.fields import KeyMotionField, MotionField
from dancedata.recipes.recipe import Recipe

#: Raised by hand when readers or `quality_flags` find more in the same input: cached clips are then examined again,
#: and their encoded motion stays.
_EXAMINED = 2
#: Up to this many values, clips remember matrices and joints while they are encoded: 200 MB.
_REMEMBERED = 2**23
_FINGERS = frozenset(SMPLX52.joints[22:])


class ClipInfo(NamedTuple):
    """Facts about a clip, as the cache holds them: a JSON array in this order."""

    n_source: int
    source_rate: str
    flags: list[dict[str, Any]]
    trim_start: int
    height_m: float
    examined: int


@dataclass(frozen=True)
class MotionResult:
    """A clip's motion, encoded.

    `n_source`, `source_rate`: Frames and rate of the source.
    `n_frames`, `trim_start`: Frames at the recipe's rate; the first that belongs to the dance.
    `height_m`: Vertical extent of the joints, median over frames, metres.
    `arrays`: Per motion and key motion field: (T, D) in track scope, (W, L, D) in window scope; (0, D) of an optional
        field that cannot take the motion.
    `without`: Why, per such field.
    """

    n_source: int
    source_rate: Fraction
    n_frames: int
    trim_start: int
    height_m: float
    flags: tuple[dict[str, Any], ...] = ()
    arrays: dict[str, CachedArray] = field(default_factory=dict)
    without: dict[str, str] = field(default_factory=dict)

    @property
    def seconds(self) -> Fraction:
        """Length of the source."""
        return self.n_source / self.source_rate

    def stored(self, recipe: Recipe, starts: tuple[int, ...]) -> dict[str, CachedArray]:
        """Return the arrays to store; in window scope only the windows that begin at `starts`."""
        if recipe.scope == "track":
            return self.arrays
        numbers = recipe.windows.numbers(starts)
        return {name: array.take(numbers) for name, array in self.arrays.items()}


def encode_motion(
    cache: Cache, recipe: Recipe, ref: ClipRef, sha256: str, keys: ClipKeys, copies: CopySpec | None = None
) -> MotionResult | Reject:
    """Load, check, resample and encode one clip, or its copy, for every motion and key motion field of the recipe."""
    try:
        with cache.lock("clips", keys.info):
            return _result(cache, keys, recipe, *_encode_missing(cache, recipe, ref, keys, sha256, copies))
    except DataError as error:
        return reject_of(error, clip=ref.id, file=ref.motion_path)


def cached_motion(cache: Cache, recipe: Recipe, keys: ClipKeys) -> MotionResult | None:
    """Return the cached result of `encode_motion`, None if a part is missing."""
    info, arrays = _encoded(cache, keys)
    return None if info is None or None in arrays.values() else _result(cache, keys, recipe, info, arrays)


def _result(
    cache: Cache, keys: ClipKeys, recipe: Recipe, info: ClipInfo, arrays: dict[str, CachedArray | None]
) -> MotionResult:
    rate = Fraction(info.source_rate)
    encoded = {name: array for name, array in arrays.items() if array is not None}
    grid = FrameGrid(rate)
    n_frames = grid.resampled_length(info.n_source, recipe.grid)
    first = min(grid.rows_up(info.trim_start, of=recipe.grid), n_frames - 1)
    absent = [f.name for f in recipe.clip_fields if f.optional and not encoded[f.name].shape[0]]
    without = {name: str(cache.json("clips", keys.fields[name])) for name in absent}
    return MotionResult(
        info.n_source, rate, n_frames, first, float(info.height_m), tuple(info.flags), encoded, without
    )


def _encoded(cache: Cache, keys: ClipKeys) -> tuple[ClipInfo | None, dict[str, CachedArray | None]]:
    """Return the cached entries of a clip."""
    cached = cache.json("clips", keys.info)
    info = ClipInfo(*cached) if cached is not None and cached[5:] == [_EXAMINED] else None
    arrays = {name: cache.array("motion", key) for name, key in keys.fields.items()}
    for name, array in arrays.items():
        # (0, D) is of an optional field, with its reason; in window scope (0, L, D) is of a clip without windows.
        is_absent = array is not None and len(array.shape) == 2 and not array.shape[0]
        if is_absent and cache.json("clips", keys.fields[name]) is None:
            arrays[name] = None
    return info, arrays


def _encode_missing(
    cache: Cache, recipe: Recipe, ref: ClipRef, keys: ClipKeys, sha256: str, copies: CopySpec | None
) -> tuple[ClipInfo, dict[str, CachedArray | None]]:
    """Load a clip and publish its missing entries; another process may have published some by now."""
    info, arrays = _encoded(cache, keys)
    if info is not None and None not in arrays.values():
        return info, arrays
    loaded = recipe.dataset.load(ref)
    motion, flags = prepared(recipe, ref, loaded, copies)
    original = prepared(recipe, ref, loaded, copies, repaired=False)[0] if _keeps_original(recipe) else motion
    return _published(cache, recipe, ref, keys, sha256, _Versions(motion, original, tuple(flags)), arrays)


class _Versions(NamedTuple):
    """A clip's motion, as it was before repairs, and the flags of what was done to it."""

    motion: Motion
    original: Motion
    flags: tuple[Flag, ...] = ()


def prepared(
    recipe: Recipe, ref: ClipRef, loaded: Motion, copies: CopySpec | None = None, *, repaired: bool = True
) -> tuple[Motion, list[Flag]]:
    """Repair and retarget the loaded motion of a single dancer, or change it for a copy; and return flags."""
    motion, flags = loaded, []
    if repaired:
        repairs = recipe.curation.repairs.apply(motion)
        motion, flags = repairs.motion, [*repairs.flags]
    if recipe.retarget is not None:
        result = recipe.retarget.apply(motion, where=str(ref.motion_path), grouped=bool(ref.group))
        motion, flags = result.motion, [*flags, *result.flags()]
    return (motion if copies is None else copies.motion_of(motion, ref.id)), flags


def _keeps_original(recipe: Recipe) -> bool:
    return not all(field.repaired for field in recipe.motion)


def _published(
    cache: Cache,
    recipe: Recipe,
    ref: ClipRef,
    keys: ClipKeys,
    sha256: str,
    versions: _Versions,
    arrays: dict[str, CachedArray | None],
    floors: Mapping[str, float] = MappingProxyType({}),
) -> tuple[ClipInfo, dict[str, CachedArray | None]]:
    """Encode a loaded motion for the fields that are missing, and publish them; `floors` are those of its group."""
    motion, original, done = versions
    if motion.rotations.size * 3 <= _REMEMBERED:
        # For all fields, and in window scope for all windows.
        motion, same = motion.with_cache(), original is motion
        original = motion if same else original.with_cache()
    encoded: dict[str, npt.NDArray[np.float32]] = {}
    without: dict[str, str] = {}
    for f in recipe.clip_fields:
        if arrays[f.name] is None:
            try:
                version = original if isinstance(f, MotionField) and not f.repaired else motion
                _require_joints(f, version)
                encoded[f.name] = _encode(recipe, f, version, floors.get(f.name))
            except (DataError, UsageError) as error:  # the latter where a plug-in cannot take the skeleton
                if not f.optional:
                    if isinstance(error, UsageError):  # ends the build, while a DataError is the clip's reject
                        error.where = error.where or ref.motion_path
                    raise
                encoded[f.name] = np.empty((0, f.columns.width), np.float32)
                without[f.name] = str(error)
    if sha256_file(ref.motion_path) != sha256:
        raise DataError(CHANGED, reason="changed", where=ref.motion_path, fix=BUILD_AGAIN)
    content = content_hashes(recipe.dataset, cache.file_sha256)
    for named in sorted({*content, *keys.content}):
        if content.get(named) != keys.content.get(named):
            raise DataError(CHANGED, reason="changed", where=f"{ref.motion_path} ({named})", fix=BUILD_AGAIN)
    flags = [f.to_json() for f in [*quality_flags(motion), *done]]
    info = ClipInfo(motion.n_frames, str(motion.grid), flags, motion.trim_start, vertical_extent(motion), _EXAMINED)
    for name, reason in without.items():
        cache.put_json("clips", keys.fields[name], reason)
    for name, array in encoded.items():
        arrays[name] = cache.put_array("motion", keys.fields[name], array, durable=False)
    cache.put_json("clips", keys.info, info)
    return info, arrays


def _require_joints(clip_field: MotionField | KeyMotionField, motion: Motion) -> None:
    """Raise DataError for an optional field with fingers where the motion has none: they would not move.

    The hands of SMPL's 24 joints, jaw and eyes are not required: few captures have them.
    """
    if not (isinstance(clip_field, MotionField) and clip_field.optional):
        return
    body, name = clip_field.representation.skeleton, clip_field.representation.name
    fingers = [joint for joint in body.joints if joint in _FINGERS]
    if fingers and not _FINGERS & set(motion.skeleton.joints):
        raise DataError(
            f"the motion has no fingers, which {name} has",
            reason="missing_joints",
            found=f"{motion.skeleton.n_joints} joints, without {fingers[0]} and {len(fingers) - 1} more",
        )


def usable_frames(recipe: Recipe, n_source: int, source_rate: Fraction) -> int:
    """Return the number of frames, at the recipe's rate, that all motion fields of a clip cover."""
    source = FrameGrid(source_rate)
    frames = [source.resampled_length(n_source, recipe.grid)]
    for motion_field in recipe.motion:
        if motion_field.grid != recipe.grid:
            frames.append(
                motion_field.grid.rows_down(source.resampled_length(n_source, motion_field.grid), of=recipe.grid)
            )
    return min(frames)


def motion_window_count(recipe: Recipe, n_source: int, source_rate: Fraction) -> int:
    """Return the number of windows of a motion of `n_source` frames.

    Track scope counts on the recipe's grid. Window scope counts as EDGE does, before decimation, where the
    source's rate is a whole multiple: 1,919 frames at 60 FPS have 54 windows at 60 FPS, 55 on the grid.
    """
    step = FrameGrid(source_rate).step_to(recipe.grid)
    count = recipe.windows.count(usable_frames(recipe, n_source, source_rate))
    if recipe.scope == "window" and step is not None:
        count = min(count, recipe.windows.times(step).count(n_source))
    return count


def encode_group(
    cache: Cache, recipe: Recipe, members: Sequence[tuple[ClipRef, str, ClipKeys]], copies: CopySpec | None = None
) -> list[MotionResult | Reject]:
    """Load, check, resample and encode the dancers of one group, or their copies, in one time and one world.

    Where a dancer cannot be loaded, the others are a group without him.
    """
    refs = [ref for ref, _, _ in members]
    try:
        with cache.lock("clips", members[0][2].info):
            encoded = [_encoded(cache, keys) for _, _, keys in members]
            if any(info is None or None in arrays.values() for info, arrays in encoded):
                group = _group_versions(recipe, refs, copies)
                grounded = [f for f in recipe.motion if f.representation.grounded]
                floors = {f.name: _floor(f, group) for f in grounded}
                encoded = [
                    _published(cache, recipe, ref, keys, sha256, versions, arrays, floors)
                    for (ref, sha256, keys), versions, (_, arrays) in zip(members, group, encoded, strict=True)
                ]
        return [
            _result(cache, keys, recipe, info, arrays)
            for (_, _, keys), (info, arrays) in zip(members, encoded, strict=True)
            if info is not None
        ]
    except DataError as error:
        unusable = unusable_dancers(recipe, refs)
        if not unusable or len(unusable) == len(members):
            return [reject_of(error, clip=ref.id, file=ref.motion_path) for ref in refs]
        others = iter(encode_group(cache, recipe, [m for k, m in enumerate(members) if k not in unusable], copies))
        return [unusable[k] if k in unusable else next(others) for k in range(len(members))]


def _floor(motion_field: MotionField, group: Sequence[_Versions]) -> float:
    """Return the floor of a group in a field: of an optional one, of the dancers that it can take."""
    floors = []
    for dancer in group:
        version = dancer.motion if motion_field.repaired else dancer.original
        try:
            _require_joints(motion_field, version)
            floors.append(motion_field.representation.floor(version.resampled(motion_field.grid)))
        except (DataError, UsageError):
            if not motion_field.optional:
                raise
    return min(floors, default=0.0)


def _group_versions(recipe: Recipe, refs: Sequence[ClipRef], copies: CopySpec | None) -> list[_Versions]:
    motions = group_motions(recipe, refs, copies)
    if not recipe.curation.repairs:
        return [_Versions(motion, motion) for motion in motions]
    flags = [recipe.curation.repairs.apply(m).flags for m in group_motions(recipe, refs, repaired=False)]
    originals = group_motions(recipe, refs, copies, repaired=False) if _keeps_original(recipe) else motions
    return [_Versions(*of_dancer) for of_dancer in zip(motions, originals, flags, strict=True)]


def cached_group(cache: Cache, recipe: Recipe, keys: Sequence[ClipKeys]) -> list[MotionResult | Reject] | None:
    """Return the cached result of `encode_group`, None if a part is missing."""
    cached = [cached_motion(cache, recipe, of_member) for of_member in keys]
    results = [result for result in cached if result is not None]
    return [*results] if len(results) == len(cached) else None


def _encode(
    recipe: Recipe, clip_field: MotionField | KeyMotionField, motion: Motion, floor_m: float | None = None
) -> npt.NDArray[np.float32]:
    if floor_m is not None and isinstance(clip_field, MotionField):
        return np.asarray(clip_field.encode_above(motion.resampled(clip_field.grid), floor_m))
    if recipe.scope == "track":
        return np.asarray(clip_field.encode(motion.resampled(clip_field.grid)))
    length = recipe.windows.length
    count = motion_window_count(recipe, motion.n_frames, motion.grid.rate)
    # EDGE cuts at the source's rate and decimates after that; frames k * step are the same either way, but
    # where rates are not whole multiples, windows can only be cut on the new grid.
    whole = motion.grid.step_to(recipe.grid) is not None and motion.grid.step_to(clip_field.grid) is not None
    source = motion if whole else motion.resampled(clip_field.grid)
    spans = [
        [recipe.grid.rows_down(frame, of=source.grid) for frame in (start, start + length)]
        for start in recipe.windows.starts(count)
    ]
    windows = [clip_field.encode(source.part(*span).resampled(clip_field.grid)) for span in spans]
    rows = recipe.grid.rows(length, of=clip_field.grid)
    return np.stack(windows) if windows else np.empty((0, rows, clip_field.columns.width), np.float32)


def vertical_extent(motion: Motion) -> float:
    """Return the distance of the highest joint from the lowest along y, median over frames, metres.

    A check of axis and unit: a standing dancer measures 1.4 to 1.7 m from the toes to the head joint.
    """
    heights = motion.joints()[..., 1]
    return round(float(np.median(heights.max(axis=1) - heights.min(axis=1))), 4)
