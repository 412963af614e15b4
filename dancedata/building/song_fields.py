"""Fields of songs without a build: those of a feature's name, or of a dataset; their rows; the dataset's tempo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dancedata.building.compute import make_all
from dancedata.building.fields.music import MusicField
from dancedata.building.inputs import Music
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.grid import Number, WindowSpec
from dancedata.core.registry import FEATURES
from dancedata.core.text import listed
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.recipes.parse import stored_recipe
from dancedata.recipes.plugins import frame_grid, make_named
from dancedata.store import Store, open_store
from dancedata.store.normalize import TrainingData
from dancedata.store.songs import music_hashes


def dataset_like(like: str | Path | Store | TrainingData | None) -> Store | None:
    """Return the dataset that a path, or a reader, names."""
    if isinstance(like, str | Path):
        return open_store(Path(like).expanduser())
    return like if like is None or isinstance(like, Store) else like.store


def music_field(
    name: str, like: Store | None, fps: Number, windows: tuple[int, int] | None, parameters: Mapping[str, Any]
) -> MusicField:
    """Return the music field of a feature's name, at the rate of `like`; `windows`: length and stride of slices."""
    if like is None:
        grid = frame_grid(fps)
        field = MusicField(name, grid, make_named(FEATURES, "audio", name, dict(parameters)))
    else:
        computed = {f.name: f for f in stored_recipe(like).audio if isinstance(f, MusicField)}
        if name not in computed or parameters:
            raise UsageError(f"no audio field {name!r} that is computed" if not parameters
                             else "the dataset states the parameters of its fields", where=str(like.path),
                             fix=did_you_mean(name, sorted(computed)) if not parameters
                             else "leave like out, or the parameters")  # fmt: skip
        field, grid = computed[name], like.grid
    if windows is not None and (len(windows) != 2 or min(windows) < 1):
        raise UsageError("windows have a length and a stride of at least 1", found=windows)
    return replace(field, windows=None if windows is None else WindowSpec(*windows, grid))


def song_rows(
    cache: Cache, field: MusicField, songs: Sequence[Music], *, jobs: Jobs, progress: Progress
) -> dict[Music, list[Any]]:
    """Return the rows of songs, an array each or one of each slice; a Reject of each that cannot be computed."""
    asks = {song: field.song_asks(song) for song in songs}
    by_key = make_all(cache, field, [ask for asked in asks.values() for ask in asked], jobs=jobs, progress=progress)
    return {song: [by_key[ask.key] for ask in asked] for song, asked in asks.items()}


def stated_tempo(dataset: Store | None, sha256: str, song: Path) -> tuple[float | None, str]:
    """Return a dataset's tempo of a song and the evidence, "samples" or "name"; None where training estimated it."""
    if dataset is None:
        return None, ""
    hashes = music_hashes(dataset.clips())
    clips = [clip for clip in dataset.clips() if not clip.source]
    same = {clip.tempo_bpm for clip in clips if sha256.startswith(hashes.get(clip.id, "-"))}
    tempos, by = (same, "samples") if same else ({c.tempo_bpm for c in clips if c.music == song.stem}, "name")
    if len(tempos) > 1:
        raise UsageError("the dataset states several tempos of this song", where=song,
                         found=listed(sorted("none" if tempo is None else f"{tempo:g} BPM" for tempo in tempos)),
                         fix="state it: --bpm")  # fmt: skip
    return next(iter(tempos), None), by
