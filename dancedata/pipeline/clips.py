"""From a source folder to clips ready to store: identify, encode, extract; nothing is dropped silently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.augment.mirror import SUFFIX, mirrored_copy
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.text import is_unicode, quoted
from dancedata.execution.cache import Cache, CachedArray
from dancedata.execution.execute import Progress, exactly, run_units
from dancedata.execution.workers import Jobs
from dancedata.pipeline.audio import SignalId, identify_audio, known_signal, window_samples
from dancedata.pipeline.features import extract_all
from dancedata.pipeline.gathered import Gathered, window_numbers
from dancedata.pipeline.motion import (
    MotionKeys,
    MotionResult,
    content_hashes,
    encode_motion,
    hash_motion,
    known_hash,
    known_motion,
    motion_window_count,
)
from dancedata.pipeline.rejects import missing_music, short_audio, too_short
from dancedata.pipeline.window_filter import still_windows
from dancedata.recipes.recipe import Recipe
from dancedata.store import AudioBlock, StoredClip


def scan_source(recipe: Recipe, source: Path) -> Scan:
    """List what the source holds. A dataset that writes its own source computes it as results are computed."""
    generates = getattr(recipe.dataset, "generates", False)
    scan: Scan = exactly(recipe.dataset.scan, source) if generates else recipe.dataset.scan(source)
    return scan


def identify(cache: Cache, recipe: Recipe, scan: Scan, *, jobs: Jobs, progress: Progress) -> Gathered:
    """Find out what every clip's files are: hash motions, decode and hash music."""
    content = content_hashes(recipe.dataset, cache.file_sha256)
    gathered = Gathered(recipe, scan, {r.id: r for r in scan.clips}, list(scan.rejects), content=content)
    for ref in scan.clips:
        texts = (ref.id, ref.split, ref.music, ref.genre, ref.dancer, *ref.lists)
        wrong = [text for text in texts if not is_unicode(text)]
        if wrong:
            # No file of a dataset could hold it.
            detail = (
                f"clip {ref.id}: {quoted(wrong[0])} is not valid Unicode; rename the file, or correct what names it"
            )
            gathered.drop(ref.id, Reject("bad_name", file=str(ref.motion_path), detail=detail))
    paths = list(dict.fromkeys(ref.motion_path for ref in gathered.refs.values()))
    calls = [(cache, path) for path in paths]
    known = [known_hash(cache, path) for path in paths]
    found = run_units(hash_motion, calls, known=known, jobs=1, label="hashing motion", progress=progress, exact=False)
    hashes = dict(zip(paths, found, strict=True))
    for ref in list(gathered.refs.values()):
        sha = hashes[ref.motion_path]
        if isinstance(sha, Reject):
            gathered.drop(ref.id, sha)
        else:
            gathered.motion_sha[ref.id] = sha
    if recipe.audio:
        _identify_music(cache, gathered, jobs, progress)
    return gathered


def _identify_music(cache: Cache, gathered: Gathered, jobs: Jobs, progress: Progress) -> None:
    paths = sorted({r.audio_path for r in gathered.refs.values() if r.audio_path is not None})
    known = [known_signal(cache, path) for path in paths]
    calls = [(cache, path) for path in paths]
    found = run_units(identify_audio, calls, known=known, jobs=jobs, label="decoding music", progress=progress)
    outcome = dict(zip(paths, found, strict=True))
    gathered.signals = {p: o for p, o in outcome.items() if isinstance(o, SignalId)}
    for ref in list(gathered.refs.values()):
        result = outcome.get(ref.audio_path) if ref.audio_path is not None else None
        if result is None:
            gathered.audio_problems[ref.id] = missing_music(ref)
        elif isinstance(result, Reject):
            gathered.audio_problems[ref.id] = replace(result, clip=ref.id)


def gather(cache: Cache, gathered: Gathered, *, jobs: Jobs, progress: Progress) -> list[StoredClip]:
    """Encode all motion and extract all features; returns the clips to store, sorted by id."""
    _check_mirrored_ids(gathered)
    motions = _encode_all(cache, gathered, jobs, progress)
    for clip, problem in gathered.audio_problems.items():
        gathered.drop(clip, problem)
    starts = {clip: _starts(gathered, clip, motions[clip]) for clip in list(gathered.refs)}
    for clip in list(gathered.refs):
        starts[clip] = _moving(gathered, clip, motions[clip], starts[clip])
    audio = extract_all(cache, gathered, starts, jobs=jobs, progress=progress)
    clips = []
    for clip in sorted(audio):
        motion, ref = motions[clip], gathered.refs[clip]
        arrays = motion.arrays
        if gathered.recipe.scope == "window":
            numbers = window_numbers(gathered.recipe, starts[clip])
            arrays = {name: array.take(numbers) for name, array in arrays.items()}
        gathered.quality += [{"clip": clip, **flag} for flag in motion.flags]
        clips.append(_stored(ref, motion, starts[clip], arrays, audio[clip]))
    return clips + _mirrored(gathered.recipe, clips)


def _moving(gathered: Gathered, clip: str, motion: MotionResult, starts: tuple[int, ...]) -> tuple[int, ...]:
    """Return the starts that the recipe's filter keeps; a clip without any is set aside."""
    kept, rejects = still_windows(gathered.recipe, gathered.refs[clip], motion, starts)
    gathered.rejects += rejects
    if rejects and not kept:
        detail = f"none of the {len(rejects)} windows of clip {clip} passes the movement filter"
        gathered.drop(clip, Reject("still", clip, str(gathered.refs[clip].motion_path), detail=detail))
    return kept


def _mirrored(recipe: Recipe, clips: Sequence[StoredClip]) -> list[StoredClip]:
    """Return mirrored copies of the train clips, if the recipe wants them."""
    if not recipe.mirror:
        return []
    columns = {slot.name: slot.representation.columns for slot in recipe.motion}
    columns |= {plugin.name: plugin.columns for plugin in recipe.keymotion}
    mirrors = {name: own.mirror for name, own in columns.items() if own.mirror is not None}
    return [mirrored_copy(clip, mirrors) for clip in clips if clip.split == "train"]


def _check_mirrored_ids(gathered: Gathered) -> None:
    both = [clip for clip in gathered.refs if gathered.recipe.mirror and clip + SUFFIX in gathered.refs]
    if both:
        raise SourceError(
            "a clip has the id that its neighbour's mirrored copy would get",
            where=f"clip {both[0]}{SUFFIX}",
            fix="rename it, or build without augment.mirror",
        )


def _stored(
    ref: ClipRef,
    motion: MotionResult,
    starts: tuple[int, ...],
    arrays: dict[str, CachedArray],
    audio: dict[str, tuple[AudioBlock, ...]],
) -> StoredClip:
    return StoredClip(
        id=ref.id,
        split=ref.split,
        genre=ref.genre,
        music=ref.music,
        dancer=ref.dancer,
        tempo_bpm=ref.tempo_bpm,
        n_flags=len(motion.flags),
        trim_start=motion.trim_start,
        height_m=motion.height_m,
        source_rate=str(motion.source_rate),
        lists=ref.lists,
        n_frames=motion.n_frames,
        starts=starts,
        motion=arrays,
        audio=audio,
    )


def _encode_all(cache: Cache, gathered: Gathered, jobs: Jobs, progress: Progress) -> dict[str, MotionResult]:
    refs = list(gathered.refs.values())
    every = MotionKeys(gathered.recipe, gathered.content)
    keys = [every.of(ref, gathered.motion_sha[ref.id]) for ref in refs]
    known = [known_motion(cache, gathered.recipe, own) for own in keys]
    calls = [(cache, gathered.recipe, r, gathered.motion_sha[r.id], own) for r, own in zip(refs, keys, strict=True)]
    motions = {}
    results = run_units(encode_motion, calls, known=known, jobs=jobs, label="encoding motion", progress=progress)
    for ref, result in zip(refs, results, strict=True):
        if isinstance(result, Reject):
            gathered.drop(ref.id, result)
        else:
            motions[ref.id] = result
    return motions


def audio_window_count(recipe: Recipe, n_samples: int, sample_rate: int) -> int:
    """Return how many windows a signal has: whole windows of samples, or of every feature's rows (track scope)."""
    if recipe.scope == "window":
        return len(window_samples(recipe, n_samples, sample_rate)[0])
    rows = [f.n_rows(n_samples, sample_rate, recipe.grid) for f in recipe.audio]
    return min(map(recipe.windows.count, rows))


def _starts(gathered: Gathered, clip: str, motion: MotionResult) -> tuple[int, ...]:
    """Return the window starts of a clip, at the recipe's rate; windows without music become rejects.

    A clip without any window is set aside: "too_short" if its motion is, "short_audio" if its music is.
    """
    recipe, ref = gathered.recipe, gathered.refs[clip]
    count = motion_window_count(recipe, motion.n_source, motion.source_rate)
    if not count:
        gathered.drop(clip, too_short(recipe, ref, motion.n_source, motion.source_rate))
        return ()
    gathered.rejects += _short_fields(recipe, ref, motion, count)
    signal = gathered.signal(ref)
    if signal is None:
        return tuple(recipe.windows.starts(count))
    audio_s = round(signal.n_samples / signal.sample_rate, 3)
    with_music = audio_window_count(recipe, signal.n_samples, signal.sample_rate)
    if not with_music:
        gathered.drop(clip, short_audio(recipe, ref, signal.path, audio_s))
    for k in range(with_music, count) if with_music else ():
        detail = f"window {k} reaches beyond the end of {signal.path.name}"
        gathered.rejects.append(Reject("no_audio", clip, "", recipe.windows.start(k), detail, {"audio_s": audio_s}))
    return tuple(recipe.windows.starts(min(count, with_music)))


def _short_fields(recipe: Recipe, ref: ClipRef, motion: MotionResult, count: int) -> list[Reject]:
    """Say which windows of the recipe's grid are lost because a field of another rate ends before they do."""
    without = recipe.windows.count(motion.n_frames)
    if recipe.scope == "window":
        return []
    rates = sorted({str(recipe.grid_of(slot)) for slot in recipe.motion})
    detail = f"fields at {' and '.join(rates)} rows a second do not all reach to the end of the window"
    return [
        Reject("short_field", ref.id, "", recipe.windows.start(k), f"{detail}, number {k}")
        for k in range(count, without)
    ]
