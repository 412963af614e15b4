"""dancedata features: one's own music, with features exactly as in training."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.atomic import atomic_file, write_json
from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import json_sha256
from dancedata.core.registry import FEATURES
from dancedata.pipeline.audio_units import is_exact, window_samples
from dancedata.pipeline.cache import Cache, default_cache
from dancedata.pipeline.documents import document_of
from dancedata.pipeline.execute import exactly, on_one_thread
from dancedata.pipeline.recipe import Recipe, resolve_feature
from dancedata.pipeline.recipe_file import load_recipe, parse_recipe
from dancedata.pipeline.slots import make_named
from dancedata.store import open_store
from dancedata.store.schema import DATASET_FILE


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
    a network's weights, where a feature needs one.
    """
    from dancedata.audio.signal import load_audio

    absent = [str(song) for song in songs if not song.is_file()]
    if absent:
        raise UsageError("there is no such song; nothing was computed", found=", ".join(absent))
    names = [song.stem for song in songs]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UsageError("two songs would be written to one file", found=", ".join(twice), fix="rename one of them")
    # Only now: weights are ten gigabytes to hash.
    likes = [replace(like, feature=_ready(like.feature, weights)) for like in likes]
    written = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        for song in songs:
            signal = load_audio(song)
            for like in likes:
                compute = exactly if is_exact(like.feature) else on_one_thread
                rows, starts = compute(_compute, like, signal, bpm, song)
                path = out / f"{song.stem}.{like.feature.name}.npy"
                with atomic_file(path) as temporary, open(temporary, "wb") as file:
                    np.save(file, rows)
                about = _about(like, song, signal, rows, starts, bpm, path)
                write_json(path.with_suffix(".json"), about)
                written.append(about)
    except OSError as error:
        raise StoreError("the features cannot be written", where=out, found=str(error)) from error
    return written


def _ready(feature: Any, weights: Path | None) -> Any:
    """Return a feature with its weights; those of a dataset are known by their hash, not by their place."""
    if weights is not None and hasattr(feature, "weights"):
        feature = replace(feature, weights=weights)
    return resolve_feature(feature, Cache(default_cache()).file_sha256)


def _compute(like: Like, signal: Any, bpm: float | None, song: Path) -> tuple[Any, list[int] | None]:
    recipe = like.recipe
    if recipe is None or recipe.scope == "track":
        return like.feature.extract(signal, like.grid, start_bpm=bpm), None
    starts, length = window_samples(recipe, signal.n_samples, signal.sample_rate)
    if not len(starts):
        raise UsageError(
            "the song is shorter than one window",
            where=song,
            found=f"{signal.n_samples / signal.sample_rate:.2f} s",
            allowed=f"at least {float(recipe.windows.length / recipe.fps):g} s",
        )
    rows = like.feature.extract_windows(signal, starts, length, like.grid, recipe.windows.length, start_bpm=bpm)
    return rows, [k * recipe.windows.stride for k in range(len(starts))]


def _about(
    like: Like, song: Path, signal: Any, rows: Any, starts: list[int] | None, bpm: float | None, path: Path
) -> dict[str, Any]:
    return {
        "song": song.name,
        "file": path.name,
        "feature": {like.feature.name: document_of(like.feature)},
        "shape": list(rows.shape),
        "dtype": str(rows.dtype),
        "fps": str(like.grid),
        "scope": like.scope,
        "window_starts": starts,
        "start_bpm": bpm,
        "signal_sha256": signal.sha256,
        "columns": list(like.feature.columns.labels),
    }


def _recipe_like(like: str) -> Recipe:
    folder = Path(like)
    if not folder.is_dir():
        return load_recipe(like)
    if not (folder / DATASET_FILE).exists():
        raise StoreError("there is no dataset to take the features' parameters from", where=folder)
    meta = open_store(folder).meta
    document = json.loads(json.dumps(meta["recipe"]))
    recipe = parse_recipe(document, where=f"{folder}/{DATASET_FILE}")
    if json_sha256(recipe.document) != json_sha256(document):
        raise StoreError("the dataset's recipe reads differently in this version of dancedata", where=folder)
    return recipe
