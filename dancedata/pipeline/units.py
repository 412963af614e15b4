"""Units of work: functions that worker processes run. Each takes and returns small, picklable things."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import sha256_bytes, sha256_file
from dancedata.core.motion import Motion
from dancedata.core.quality import MAX_ROOT_SPEED_M_S, MAX_TURN_DEG_S, quality_flags
from dancedata.core.windows import count_windows
from dancedata.pipeline.cache import Cache, CachedArray, package_version
from dancedata.pipeline.recipe import MotionSlot, Recipe
from dancedata.pipeline.slots import document_of

#: Raised by hand when a stage here gives other numbers for the same input.
MOTION_STAGE = 1
FEATURE_STAGE = 1


@dataclass(frozen=True)
class SignalId:
    """What an audio file decodes to; `windows` are the hashes of its windows (window scope)."""

    path: Path
    sha256: str
    sample_rate: int
    n_samples: int
    windows: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionResult:
    """A clip's motion, encoded.

    Attributes
    ----------
    n_source, source_rate
        Frames and rate of the source.
    n_frames
        Frames at the recipe's rate.
    arrays
        Per representation: (T, D) in track scope, (W, L, D) in window scope.
    """

    n_source: int
    source_rate: Fraction
    n_frames: int
    flags: tuple[dict[str, Any], ...] = ()
    arrays: dict[str, CachedArray] = field(default_factory=dict)


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Say in rejects.jsonl what an error says."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def window_samples(recipe: Recipe, n_samples: int, sample_rate: int) -> tuple[npt.NDArray[np.int64], int]:
    """Return the first samples (W,) of a signal's whole windows, and their length in samples.

    Every window starts at its own exact time, rounded down, so that music never drifts away from motion. EDGE
    adds up a truncated stride, which is the same wherever a stride is a whole number of samples (0.5 s at any
    even rate).
    """
    length = int(recipe.windows.length / recipe.fps * sample_rate)
    stride = recipe.windows.stride / recipe.fps * sample_rate
    if n_samples < length or length < 1:
        return np.empty(0, dtype=np.int64), length
    # Start k is floor(k * stride), so the last k that fits is the last with k * stride < n - length + 1.
    count = math.ceil((n_samples - length + 1) / stride)
    starts = [k * stride.numerator // stride.denominator for k in range(count)]
    return np.array(starts, dtype=np.int64), length


def identify_audio(cache: Cache, recipe: Recipe, path: Path) -> SignalId | Reject:
    """Decode a file and hash its samples, and its windows' in window scope; remembered until the file changes."""
    from dancedata.audio.signal import load_audio

    windows = [str(recipe.fps), recipe.windows.length, recipe.windows.stride] if recipe.scope == "window" else None
    packages = {"soundfile": package_version("soundfile"), "libsndfile": libsndfile_version()}
    try:
        key = Cache.key("signal", file=Cache.stat_key("signal", path), windows=windows, packages=packages)
        known = cache.json("signals", key)
        if known is None:
            signal = load_audio(path)
            hashes = []
            if windows is not None:
                starts, length = window_samples(recipe, signal.n_samples, signal.sample_rate)
                for start in starts:
                    part = np.ascontiguousarray(signal.samples[start : start + length], dtype="<f4")
                    hashes.append(sha256_bytes(f"{signal.sample_rate} ".encode(), part.data))
            known = [signal.sha256, signal.sample_rate, signal.n_samples, hashes]
            cache.put_json("signals", key, known)
    except DataError as error:
        return reject_of(error, file=path)
    except FileNotFoundError:
        return Reject("missing_music", file=str(path), detail=f"{path}: the file vanished during the build")
    return SignalId(path, known[0], known[1], known[2], tuple(known[3]))


def libsndfile_version() -> str:
    """Return the version of the library that decodes music."""
    import soundfile

    return str(soundfile.__libsndfile_version__)


def hash_motion(cache: Cache, ref: ClipRef) -> str | Reject:
    """Return the hash of a motion file."""
    try:
        return cache.file_sha256(ref.motion_path)
    except OSError as error:
        return Reject("broken_file", clip=ref.id, file=str(ref.motion_path), detail=f"{ref.motion_path}: {error}")


def encode_motion(cache: Cache, recipe: Recipe, ref: ClipRef, sha256: str) -> MotionResult | Reject:
    """Load, check, resample and encode one clip, for every representation of the recipe."""
    keys = {slot.name: _motion_key(recipe, slot, sha256) for slot in recipe.motion}
    info_key = _info_key(recipe, sha256)
    info = cache.json("clips", info_key)
    arrays = {name: cache.array("motion", key) for name, key in keys.items()}
    if info is None or any(a is None for a in arrays.values()):
        try:
            motion = recipe.dataset.load(ref)
        except DataError as error:
            return reject_of(error, clip=ref.id, file=ref.motion_path)
        if sha256_file(ref.motion_path) != sha256:
            return _changed(ref.motion_path, ref.id)
        info = [motion.n_frames, str(motion.grid), [f.to_json() for f in quality_flags(motion)]]
        cache.put_json("clips", info_key, info)
        for slot in recipe.motion:
            if arrays[slot.name] is None:
                array = _encode(recipe, slot, motion)
                arrays[slot.name] = cache.put_array("motion", keys[slot.name], array)
    n_source, rate = int(info[0]), Fraction(info[1])
    found = {name: array for name, array in arrays.items() if array is not None}
    n_frames = FrameGrid(rate).resampled_length(n_source, recipe.grid)
    return MotionResult(n_source, rate, n_frames, tuple(info[2]), found)


def motion_window_count(recipe: Recipe, n_source: int, source_rate: Fraction) -> int:
    """Return how many windows a motion of `n_source` frames has.

    Track scope counts on the recipe's grid. Window scope counts as EDGE does, before decimation, where the
    source's rate is a whole multiple: 1,919 frames at 60 FPS have 54 windows there, 55 on the grid.
    """
    length, stride = recipe.windows.length, recipe.windows.stride
    source = FrameGrid(source_rate)
    step = source.step_to(recipe.grid)
    if recipe.scope == "window" and step is not None:
        return count_windows(n_source, length * step, stride * step)
    return count_windows(source.resampled_length(n_source, recipe.grid), length, stride)


def extract_track(cache: Cache, recipe: Recipe, feature: Any, signal: SignalId, bpm: float | None) -> Any:
    """Compute a feature of a whole signal; returns (key, CachedArray) or a Reject."""
    key = _feature_key(recipe, feature, bpm, signal=signal.sha256)
    array = cache.array("features", key)
    if array is None:
        try:
            rows = feature.extract(_decoded(signal), recipe.grid, start_bpm=bpm)
        except DataError as error:
            return reject_of(error, file=signal.path)
        array = cache.put_array("features", key, rows)
    return key, array


def extract_windows(
    cache: Cache, recipe: Recipe, feature: Any, signal: SignalId, bpm: float | None, numbers: Sequence[int]
) -> Any:
    """Compute a feature of windows, each by itself; returns {number: (key, CachedArray)} or a Reject."""
    found: dict[int, tuple[str, CachedArray]] = {}
    decoded = None
    starts, length = window_samples(recipe, signal.n_samples, signal.sample_rate)
    for number in numbers:
        key = window_key(recipe, feature, bpm, signal.windows[number])
        array = cache.array("features", key)
        if array is None:
            try:
                decoded = decoded or _decoded(signal)
                rows = feature.extract_windows(
                    decoded, starts[number : number + 1], length, recipe.grid, recipe.windows.length, start_bpm=bpm
                )[0]
            except DataError as error:
                return reject_of(error, file=signal.path)
            array = cache.put_array("features", key, rows)
        found[number] = key, array
    return found


def window_key(recipe: Recipe, feature: Any, bpm: float | None, window: str) -> str:
    """Return the cache key of a window's features; `window` is the hash of its samples."""
    return _feature_key(recipe, feature, bpm, window=window, rows=recipe.windows.length)


def _decoded(signal: SignalId) -> AudioSignal:
    """Decode a signal again; DataError "changed" if the file holds another one by now.

    Without this a file that is replaced during a build would leave its features under the old one's key, and
    every later build would take them.
    """
    from dancedata.audio.signal import load_audio

    decoded = load_audio(signal.path)
    if decoded.sha256 != signal.sha256:
        raise DataError(_CHANGED, reason="changed", where=signal.path, fix=_BUILD_AGAIN)
    return decoded


_CHANGED = "the file changed while the build was running"
_BUILD_AGAIN = "run the build again when the source is at rest"


def _changed(path: Path, clip: str) -> Reject:
    return reject_of(DataError(_CHANGED, reason="changed", where=path, fix=_BUILD_AGAIN), clip=clip, file=path)


def _encode(recipe: Recipe, slot: MotionSlot, motion: Motion) -> np.ndarray[Any, Any]:
    representation = slot.representation
    if recipe.scope == "track":
        return np.asarray(representation.encode(motion.resampled(recipe.grid), slot.contacts))
    length, stride = recipe.windows.length, recipe.windows.stride
    step = motion.grid.step_to(recipe.grid)
    count = motion_window_count(recipe, motion.n_frames, motion.grid.rate)
    # EDGE cuts at the source's rate and decimates after that; frames k * step are the same either way, but
    # where rates are no whole multiples windows can only be cut on the new grid.
    source = motion.resampled(recipe.grid) if step is None else motion
    step = 1 if step is None else step
    windows = [
        representation.encode(
            source.part(k * stride * step, (k * stride + length) * step).resampled(recipe.grid), slot.contacts
        )
        for k in range(count)
    ]
    return np.stack(windows) if windows else np.empty((0, length, representation.columns.width), np.float32)


def _numeric_packages() -> dict[str, str]:
    return {name: package_version(name) for name in ("numpy", "scipy")}


def _loading(recipe: Recipe) -> list[Any]:
    """Return all of the dataset that shapes what `load` makes of a file."""
    return [recipe.dataset.name, recipe.dataset.version, document_of(recipe.dataset, loading=True)]


def _info_key(recipe: Recipe, sha256: str) -> str:
    limits = [MAX_TURN_DEG_S, MAX_ROOT_SPEED_M_S]
    return Cache.key("clip", version=MOTION_STAGE, dataset=_loading(recipe), file=sha256, limits=limits)


def _motion_key(recipe: Recipe, slot: MotionSlot, sha256: str) -> str:
    rule = slot.contacts
    return Cache.key(
        "motion",
        version=[MOTION_STAGE, slot.representation.version, rule.version if rule is not None else 0],
        dataset=_loading(recipe),
        file=sha256,
        representation={slot.name: slot.document()},
        fps=str(recipe.grid),
        windows=[recipe.windows.length, recipe.windows.stride] if recipe.scope == "window" else None,
        packages=_numeric_packages(),
    )


def _feature_key(recipe: Recipe, feature: Any, bpm: float | None, **content: Any) -> str:
    return Cache.key(
        "feature",
        version=[FEATURE_STAGE, feature.version],
        feature={feature.name: document_of(feature)},
        fps=str(recipe.grid),
        scope=recipe.scope,
        start_bpm=bpm,
        packages={name: package_version(name) for name in feature.packages},
        **content,
    )
