"""dancedata features: one's own music, with features exactly as in training."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.audio.signal import load_audio
from dancedata.core.atomic import atomic_file, write_json
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import json_sha256
from dancedata.core.registry import FEATURES
from dancedata.core.strict_json import read_json
from dancedata.core.text import shown
from dancedata.pipeline.audio_units import is_exact, window_samples
from dancedata.pipeline.cache import Cache, default_cache
from dancedata.pipeline.documents import document_of
from dancedata.pipeline.execute import exactly, on_one_thread
from dancedata.pipeline.recipe import Recipe, resolve_feature
from dancedata.pipeline.recipe_file import load_recipe, parse_recipe, recipe_names
from dancedata.pipeline.slots import make_named
from dancedata.store import open_store
from dancedata.store.schema import DATASET_FILE

#: Of a .json beside features: the first frames of a day's windows.
_MAX_ABOUT_BYTES = 1 << 26
_MUSIC = (".wav", ".flac", ".mp3", ".ogg")


@dataclass(frozen=True)
class Like:
    """How features are computed: as a dataset or recipe does it, or plainly per track at 30 a second."""

    feature: Any
    grid: FrameGrid
    recipe: Recipe | None

    @property
    def scope(self) -> str:
        """Scope of the features."""
        return self.recipe.scope if self.recipe is not None else "track"


def find_like(feature: str | None, like: str | None) -> list[Like]:
    """Find the feature's parameters, rate and scope in a built dataset, a recipe or, without one, the defaults.

    Without `feature`, all audio features of `like` are meant, or librosa35.
    """
    if like is None:
        made = make_named(FEATURES, "audio", feature or "librosa35", {})
        return [Like(made, FrameGrid.of(30), None)]
    recipe = _recipe_like(like)
    names = [f.name for f in recipe.audio]
    if not names:
        raise UsageError(f"{like} has no audio features", fix="name another dataset or recipe, or none")
    if feature is not None and feature not in names:
        raise UsageError(f"{like} has no audio feature {feature!r}", fix=did_you_mean(str(feature), names))
    return [Like(f, recipe.grid, recipe) for f in recipe.audio if feature in (None, f.name)]


def write_features(
    songs: Sequence[Path], out: Path, likes: Sequence[Like], bpm: float | None, weights: Path | None = None
) -> list[dict[str, Any]]:
    """Write OUT/<song>.<feature>.npy and a .json beside it that says what it is; returns the JSON's content.

    (T, D) in track scope; in window scope (W, L, D), each window by itself as in training. `weights` is the folder of
    a network's weights, where a feature needs one. Where it fails, nothing is left behind; where it is interrupted,
    the songs that are done are.
    """
    if bpm is not None and not 0 < bpm < float("inf"):
        fix = "without --bpm the tempo is estimated"
        raise UsageError("not a valid tempo; nothing was computed", found=bpm, allowed="--bpm above 0", fix=fix)
    _check_songs(songs)
    _check_names(songs, out, likes)
    # Only now: weights are ten gigabytes to hash.
    likes = [replace(like, feature=_ready(like.feature, weights)) for like in likes]
    _check_signals(songs, likes)
    written = []
    try:
        with _undone_if_it_fails(out) as new:
            for song in songs:
                signal = load_audio(song)
                for like in likes:
                    path = _rows_file(out, song, like)
                    new.update(p for p in (path, path.with_suffix(".json")) if not p.exists())
                    compute = exactly if is_exact(like.feature) else on_one_thread
                    computed = compute(_compute, like, signal, bpm, song)
                    with atomic_file(path) as temporary, open(temporary, "wb") as file:
                        np.save(file, computed.rows)
                    about = _about(like, song, signal, computed, bpm, path)
                    write_json(path.with_suffix(".json"), about)
                    written.append(about)
    except OSError as error:
        raise StoreError("the features cannot be written", where=out, found=str(error)) from error
    return written


def _check_songs(songs: Sequence[Path]) -> None:
    for song in songs:
        if song.is_dir():
            raise _not_a_song(song)
    absent = [str(song) for song in songs if not song.is_file()]
    if absent:
        raise UsageError("there is no such song; nothing was computed", found=", ".join(absent))
    names = [song.stem for song in songs]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UsageError("two songs would be written to one file", found=", ".join(twice), fix="rename one of them")


def _check_names(songs: Sequence[Path], out: Path, likes: Sequence[Like]) -> None:
    """Raise UsageError if a file would be replaced that this command did not write."""
    paths = [_rows_file(out, song, like) for song in songs for like in likes]
    foreign = [path for path in paths if not _is_free(path)]
    if foreign:
        raise UsageError(
            "files would be replaced that are not known as features of dancedata; nothing was computed",
            where=out,
            found=", ".join(shown(path.name) for path in foreign[:5]) + (", ..." if len(foreign) > 5 else ""),
            allowed="no such files, or a .npy with the .json that was written beside it",
            fix="choose another --out, or move them away",
        )


def _rows_file(out: Path, song: Path, like: Like) -> Path:
    return out / f"{song.stem}.{like.feature.name}.npy"


def _is_free(path: Path) -> bool:
    """Tell whether features may be written to a path: nothing is there, or features with what is said of them."""
    about = path.with_suffix(".json")
    if not os.path.lexists(about):
        return not os.path.lexists(path)
    try:
        found = read_json(about, _MAX_ABOUT_BYTES)
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("file") == path.name and "signal_sha256" in found


def _not_a_song(folder: Path) -> UsageError:
    found = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in _MUSIC)
    example = f", such as {found[0]}" if found else ""
    files = f"{folder}/*{Path(found[0]).suffix if found else '.wav'}"
    return UsageError(
        "this is a folder, not a song; nothing was computed",
        where=folder,
        found=f"{len(found)} audio files{example}",
        fix=f"name its files: dancedata features {files} --out DIR",
    )


def _check_signals(songs: Sequence[Path], likes: Sequence[Like]) -> None:
    """Raise the error of the first song that cannot be used, before the others are computed."""
    if len(songs) > 1:  # of one song, computing it says the same
        for song in songs:
            signal = load_audio(song)
            for like in likes:
                _windows(like, signal, song)


@contextmanager
def _undone_if_it_fails(out: Path) -> Iterator[set[Path]]:
    """Make the folder; on an error remove the files that the caller has added to the set, and what was made."""
    missing = [folder for folder in (out, *out.parents) if not folder.exists()]
    new: set[Path] = set()
    try:
        out.mkdir(parents=True, exist_ok=True)
        yield new
    except BaseException as error:
        if isinstance(error, Exception):
            for path in new:
                path.unlink(missing_ok=True)
        for folder in missing:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


def _ready(feature: Any, weights: Path | None) -> Any:
    """Return a feature with its weights; those of a dataset are known by their hash, not by their place."""
    if weights is not None and hasattr(feature, "weights"):
        feature = replace(feature, weights=weights)
    return resolve_feature(feature, Cache(default_cache()).file_sha256)


@dataclass(frozen=True)
class _Computed:
    """Rows of a song, the windows' first frames, and the tempo that was estimated: one, or one a window."""

    rows: Any
    starts: list[int] | None = None
    estimated_bpm: float | list[float] | None = None


def _compute(like: Like, signal: AudioSignal, bpm: float | None, song: Path) -> _Computed:
    windows = _windows(like, signal, song)
    estimates = bpm is None and hasattr(like.feature, "estimated_bpm")
    if windows is None or like.recipe is None:
        estimated = like.feature.estimated_bpm(signal, like.grid) if estimates else None
        start_bpm = bpm if estimated is None else estimated
        return _Computed(like.feature.extract(signal, like.grid, start_bpm=start_bpm), estimated_bpm=estimated)
    starts, length = windows
    rows = like.feature.extract_windows(signal, starts, length, like.grid, like.recipe.windows.length, start_bpm=bpm)
    tempos = like.feature.estimated_window_bpms(signal, starts, length, like.grid) if estimates else None
    return _Computed(rows, [k * like.recipe.windows.stride for k in range(len(starts))], tempos)


def _windows(like: Like, signal: AudioSignal, song: Path) -> tuple[Any, int] | None:
    """Return first samples and length of a song's windows, None in track scope; UsageError if it has none."""
    recipe = like.recipe
    if recipe is None or recipe.scope == "track":
        return None
    starts, length = window_samples(recipe, signal.n_samples, signal.sample_rate)
    if not len(starts):
        raise UsageError(
            "the song is shorter than one window",
            where=song,
            found=f"{signal.n_samples / signal.sample_rate:.2f} s",
            allowed=f"at least {float(recipe.windows.length / recipe.fps):g} s",
        )
    return starts, length


def _about(
    like: Like, song: Path, signal: AudioSignal, computed: _Computed, bpm: float | None, path: Path
) -> dict[str, Any]:
    uses_tempo = getattr(like.feature, "uses_tempo", True)
    return {
        "song": song.name,
        "file": path.name,
        "feature": {like.feature.name: document_of(like.feature)},
        "shape": list(computed.rows.shape),
        "dtype": str(computed.rows.dtype),
        "fps": str(like.grid),
        "scope": like.scope,
        "window_starts": computed.starts,
        "start_bpm": bpm,
        "tempo_bpm": computed.estimated_bpm if bpm is None else bpm if uses_tempo else None,
        "tempo_estimated": computed.estimated_bpm is not None,
        "signal_sha256": signal.sha256,
        "columns": list(like.feature.columns.labels),
    }


def describe_features(out: Path, about: Mapping[str, Any]) -> str:
    """Return the line that `features` prints of a song."""
    shape = " x ".join(str(n) for n in about["shape"])
    said = f"{shown(out / about['file'])}: {shape} {about['dtype']}, {about['fps']} a second, {about['scope']} scope"
    tempo = about["tempo_bpm"]
    if about["tempo_estimated"] and isinstance(tempo, list):
        return f"{said}; tempo of each window estimated: {min(tempo):.5g} to {max(tempo):.5g} BPM"
    if about["tempo_estimated"]:
        return f"{said}; tempo estimated: {tempo:.5g} BPM (--bpm sets it)"
    return said


def _recipe_like(like: str) -> Recipe:
    folder = Path(like)
    if not folder.is_dir():
        if not folder.exists() and folder.suffix not in (".yaml", ".yml") and like not in recipe_names():
            problem = f"there is neither a dataset folder nor a recipe {shown(like)}"
            raise UsageError(problem, fix=did_you_mean(like, recipe_names()))
        return load_recipe(like)
    if not (folder / DATASET_FILE).exists():
        raise StoreError("there is no dataset to take the features' parameters from", where=folder)
    meta = open_store(folder).meta
    document = json.loads(json.dumps(meta.get("recipe", {})))
    recipe = parse_recipe(document, where=f"{folder}/{DATASET_FILE}")
    if json_sha256(recipe.document) != json_sha256(document):
        raise StoreError("the dataset's recipe reads differently in this version of dancedata", where=folder)
    return recipe
