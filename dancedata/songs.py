"""Features of any music, exactly as in training."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AUDIO_SUFFIXES, AudioSignal
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, SourceError, StoreError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.hashing import json_sha256
from dancedata.core.implausible import implausible_problems
from dancedata.core.plugins import AudioFeature
from dancedata.core.quality import music_flags
from dancedata.core.registry import FEATURES
from dancedata.core.text import listed, shown
from dancedata.files.atomic import atomic_file, write_json
from dancedata.files.listing import named_files
from dancedata.files.publish import new_folders
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json
from dancedata.kernel import (
    DATASET_FILE,
    Cache,
    Music,
    MusicField,
    Progress,
    Recipe,
    SignalId,
    Store,
    TrainingData,
    identify_audio,
    load_audio,
    load_recipe,
    make_named,
    music_field,
    open_store,
    song_rows,
    stated_tempo,
    stored_recipe,
    unit_runner,
)
from dancedata.scene.like import opened, store_of

#: Largest .json of features: it lists the first frames of a day's windows.
_MAX_ABOUT_BYTES = 1 << 26


def features(
    song: str | Path | AudioSignal,
    field: str = "librosa35",
    *,
    like: str | Path | Store | TrainingData | None = None,
    fps: Number = 30,
    bpm: float | None = None,
    windows: tuple[int, int] | None = None,
    **parameters: Any,
) -> npt.NDArray[Any]:
    """Compute an audio feature of a song, as a build does. Nothing is kept; `FeatureCache` is the same call, kept.

    Parameters
    ----------
    song
        An audio file (wav, flac, mp3, ogg) or an AudioSignal.
    field
        Name of a registered audio feature, such as "librosa35"; with `like` a field of the dataset.
    like
        Dataset, or reader of one, with whose parameters, rate and tempo of the song the field is computed.
    fps
        Rows per second, without `like`.
    bpm
        Tempo to start from, where the feature tracks beats. None: what `like` states of the song, else it is
        estimated.
    windows
        Length and stride in frames: each window by itself, as a build of slices has it. None: the whole song.
    parameters
        Parameters of the feature, as in a recipe, without `like`.

    Returns
    -------
    (T, D) array, or (W, L, D) of W windows
        A row per frame; float32, or the feature's type.

    Raises
    ------
    UsageError
        For an unknown feature, field or parameter, with the closest name.
    DataError
        If the song cannot be read, or the feature cannot be computed of it.

    Examples
    --------
    >>> import dancedata
    >>> dancedata.features("song.wav", "librosa35", fps=30, bpm=120).shape
    (211, 35)
    """
    store = None if like is None else store_of(opened(like))
    job = music_field(field, store, fps, windows, parameters)
    job = replace(job, feature=job.feature.resolved(sha256_file))
    signal = song if isinstance(song, AudioSignal) else load_audio(song)
    place = Path("song" if isinstance(song, AudioSignal) else song)
    if bpm is None:
        bpm, _ = stated_tempo(store, signal.sha256, place)
    compute = unit_runner(job.feature.exact)
    if job.windows is None:
        rows: npt.NDArray[Any] = compute(partial(job.feature.extract, start_bpm=bpm), signal, job.grid)
        return rows
    starts, length = job.slices(signal.n_samples, signal.sample_rate)
    many = partial(job.feature.extract_windows, start_bpm=bpm)
    rows = compute(many, signal, starts, length, job.grid, job.slice_rows)
    return rows


def find_jobs(feature: str | None, like: str | None) -> list[MusicField]:
    """Return the audio features of `like`, a dataset or recipe, or `feature`; else librosa35 at 30 rows a second."""
    if like is None:
        plugin = make_named(FEATURES, "audio", feature or "librosa35", {})
        return [MusicField(plugin.name, FrameGrid.of(30), plugin)]
    recipe = _recipe_like(like)
    names = [job.name for job in recipe.audio]
    if not names:
        raise UsageError(f"{like} has no audio features", fix="name another dataset, or none")
    if feature is not None and feature not in names:
        raise UsageError(f"{like} has no audio feature {feature!r}", fix=did_you_mean(str(feature), names))
    fields = [field for field in recipe.audio if feature in (None, field.name)]
    jobs = [field for field in fields if isinstance(field, MusicField)]
    if of_files := [field.name for field in fields if field.from_files]:
        computed = [field.name for field in recipe.audio if not field.from_files]
        raise UsageError(f"{listed(of_files)} of {like} comes from files and is not computed",
                         fix=f"choose others with --field: {listed(computed) or 'there are none'}")  # fmt: skip
    return jobs


def write_features(
    songs: Sequence[Path],
    out: Path,
    jobs: Sequence[MusicField],
    bpm: float | None,
    weights: Path | Sequence[str | Path] = (),
    *,
    like: str | None = None,
) -> list[dict[str, Any]]:
    """Write OUT/<song>.<feature>.npy, as `features` returns it, and a .json about it; return the JSON's content.

    Songs are files, folders of them, and patterns such as ``songs/*.wav``. An error leaves no file behind.

    `bpm`: Tempo of the songs. None: as `like` states for the same samples or name; without such a song an estimate.
    `weights`: Folders of networks' weights: "FIELD=FOLDER", or a folder alone where one feature needs weights.
    """
    if bpm is not None and not 0 < bpm < float("inf"):
        fix = "without --bpm the tempo is estimated"
        raise UsageError("not a valid tempo; nothing was computed", found=bpm, allowed="--bpm above 0", fix=fix)
    songs = named_files(songs, AUDIO_SUFFIXES)
    _check_songs(songs)
    _check_names(songs, out, jobs)
    # Only now: weights are ten gigabytes to hash.
    dataset = None if like is None else _dataset_like(like)
    folders = _weights_of([weights] if isinstance(weights, Path) else weights, jobs)
    jobs = [replace(job, feature=_ready(job, folders.get(job.name), dataset)) for job in jobs]
    cache = Cache.at()
    signals = {song: _identified(cache, song, jobs) for song in songs}  # all, before anything is computed
    written = []
    try:
        with _undone_if_it_fails(out) as new:
            for song, signal in signals.items():
                stated = (bpm, "--bpm") if bpm is not None else stated_tempo(dataset, signal.sha256, song)
                for job in jobs:
                    path = _rows_file(out, song, job)
                    new.update(p for p in (path, path.with_suffix(".json")) if not p.exists())
                    computed = _compute(cache, job, signal, stated[0])
                    with atomic_file(path) as temporary, open(temporary, "wb") as file:
                        np.save(file, computed.rows)
                    record = _about(job, song, signal, computed, stated, path)
                    write_json(path.with_suffix(".json"), record)
                    written.append(record)
    except OSError as error:
        raise StoreError("the features cannot be written", where=out, found=str(error)) from error
    return written


def _check_songs(songs: Sequence[Path]) -> None:
    names = [song.stem for song in songs]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UsageError("two songs would be written to one file", found=", ".join(twice), fix="rename one of them")


def _check_names(songs: Sequence[Path], out: Path, jobs: Sequence[MusicField]) -> None:
    paths = [_rows_file(out, song, job) for song in songs for job in jobs]
    foreign = [path for path in paths if not _is_free(path)]
    if foreign:
        raise UsageError("refusing to overwrite files that dancedata did not write; nothing was computed", where=out,
                         found=listed(path.name for path in foreign),
                         allowed="no such files, or a .npy with the .json that was written with it",
                         fix="choose another --out, or move them away")  # fmt: skip


def _rows_file(out: Path, song: Path, job: MusicField) -> Path:
    return out / f"{song.stem}.{job.name}.npy"


def _is_free(path: Path) -> bool:
    """Return whether features may be written to a path: it is free, or has the features that its .json describes."""
    record_path = path.with_suffix(".json")
    if not os.path.lexists(record_path):
        return not os.path.lexists(path)
    try:
        record = read_json(record_path, _MAX_ABOUT_BYTES)
        if not isinstance(record, dict) or record.get("file") != path.name or "sha256" not in record:
            return False
        return not os.path.lexists(path) or sha256_file(path) == record["sha256"]
    except (OSError, ValueError):
        return False


def _identified(cache: Cache, song: Path, jobs: Sequence[MusicField]) -> SignalId:
    """Return the signal of a song; DataError if it cannot be decoded, UsageError if it has no slices for a job."""
    signal: SignalId = _unwrapped(identify_audio(cache, song.absolute()))
    for job in (job for job in jobs if job.windows is not None):
        starts, length = job.slices(signal.n_samples, signal.sample_rate)
        if not len(starts):
            raise UsageError("the song is shorter than one window", where=song,
                             found=f"{signal.n_samples / signal.sample_rate:.2f} s",
                             allowed=f"at least {length / signal.sample_rate:g} s")  # fmt: skip
    return signal


def _unwrapped(result: Any) -> Any:
    if isinstance(result, Reject):
        raise DataError(result.detail, reason=result.reason)
    return result


@contextmanager
def _undone_if_it_fails(out: Path) -> Iterator[set[Path]]:
    """Make the folder; on an error remove it again, and the files that the caller has added to the set."""
    new: set[Path] = set()
    with new_folders(out):
        try:
            yield new
        except Exception:
            for path in new:
                path.unlink(missing_ok=True)
            raise


def _weights_of(options: Sequence[str | Path], jobs: Sequence[MusicField]) -> dict[str, Path]:
    takers = [job.name for job in jobs if job.feature.with_weights(Path()) is not job.feature]
    folders: dict[str, Path] = {}
    for text in map(str, options):
        name, named, folder = text.partition("=")
        if not named or (name not in takers and Path(text).expanduser().exists()):
            if len(takers) != 1:
                problem = "several features take weights, and a folder alone does not name one"
                allowed = listed(f"{taker}=FOLDER" for taker in takers) or None
                problem = problem if takers else "no feature here takes weights"
                raise UsageError(problem, found=f"--weights {text}", allowed=allowed)
            name, folder = takers[0], text
        if name not in takers:
            raise UsageError(
                f"no feature {name!r} here takes weights", found=f"--weights {text}", fix=did_you_mean(name, takers)
            )
        if name in folders:
            raise UsageError(f"--weights names two folders for {name}", found=f"{folders[name]} and {folder}")
        folders[name] = Path(folder).expanduser()
    return folders


def _ready(job: MusicField, weights: Path | None, dataset: Store | None) -> AudioFeature:
    """Return a feature with its weights; a dataset records their hash, not their place."""
    feature = job.feature
    if weights is not None:
        feature = feature.with_weights(weights)
    try:
        return feature.resolved(Cache.at().file_sha256)
    except (UsageError, SourceError) as error:
        model = None if dataset is None else dataset.weights.get(job.name)
        if dataset is not None and model:
            name = shown(job.name)
            weights_fix = f"{name} of {shown(dataset.path)} was computed with {model}: --weights {name}=FOLDER"
            error.fix = f"{error.fix}. {weights_fix}" if error.fix else weights_fix
        raise


@dataclass(frozen=True)
class _Computed:
    """Rows of a song, the windows' first rows, and the estimated tempo: one, or one per window."""

    rows: Any
    starts: list[int] | None = None
    estimated_bpm: float | list[float] | None = None


def _compute(cache: Cache, field: MusicField, song: SignalId, bpm: float | None) -> _Computed:
    music, quiet = Music(song, bpm=bpm), Progress(quiet=True)

    def rows(cache: Cache) -> list[npt.NDArray[Any]]:
        return [
            np.asarray(_unwrapped(row)) for row in song_rows(cache, field, [music], jobs=1, progress=quiet)[music]
        ]

    computed = cache.retry_lost(rows, quiet)
    estimated = _estimated(field, song.load()) if music.bpm is None else None
    if field.windows is None:
        return _Computed(computed[0], estimated_bpm=estimated)
    first_rows = [field.windows.grid.rows(start, of=field.grid) for start in field.windows.starts(len(computed))]
    return _Computed(np.stack(computed), first_rows, estimated)


def _estimated(field: MusicField, signal: AudioSignal) -> Any:
    """Return the tempo that a feature estimates: one, or of each slice; None where it estimates none."""
    compute = unit_runner(field.feature.exact)
    if field.windows is None:
        return compute(field.feature.estimated_bpm, signal, field.grid)
    starts, length = field.slices(signal.n_samples, signal.sample_rate)
    return compute(field.feature.estimated_window_bpms, signal, starts, length, field.grid)


def _about(
    job: MusicField,
    song: Path,
    signal: SignalId,
    computed: _Computed,
    stated: tuple[float | None, str],
    path: Path,
) -> dict[str, Any]:
    bpm, source = stated
    seconds = signal.grid.seconds(signal.n_samples)
    tempo = computed.estimated_bpm if bpm is None else bpm if job.feature.uses_tempo else None
    return {
        "song": song.name,
        "file": path.name,
        "sha256": sha256_file(path),
        "feature": {job.name: job.document()},
        "shape": list(computed.rows.shape),
        "dtype": str(computed.rows.dtype),
        "fps": str(job.grid),
        "window_starts": computed.starts,
        "start_bpm": bpm,
        "tempo_bpm": tempo,
        "tempo_estimated": computed.estimated_bpm is not None,
        "tempo_from": None if tempo is None else "estimate" if bpm is None else source,
        "signal_sha256": signal.sha256,
        "music": [[kind, value] for kind, value in signal.noted(Fraction(0), seconds)],
        "columns": list(job.feature.columns.labels),
    }


def describe_features(out: Path, record: Mapping[str, Any]) -> str:
    """Return the lines that `features` prints of a song."""
    rows = [{"clip": record["song"], **flag.to_json()} for flag in music_flags(record["music"])]
    return "\n".join([_line(out, record), *(f"  note: {p.reason}: {p.detail}" for p in implausible_problems(rows))])


def _line(out: Path, record: Mapping[str, Any]) -> str:
    shape = " x ".join(str(n) for n in record["shape"])
    rate = f"{record['fps']} rows per second"
    text = f"{shown(out / record['file'])}: {shape} {record['dtype']}, {rate}"
    tempo = record["tempo_bpm"]
    if record["tempo_estimated"] and isinstance(tempo, list):
        return f"{text}; tempo of each window estimated: {min(tempo):.5g} to {max(tempo):.5g} BPM"
    if record["tempo_estimated"]:
        return f"{text}; tempo estimated: {tempo:.5g} BPM (--bpm sets it)"
    phrases = {
        "samples": "as the dataset states for this song, known by its samples",
        "name": "as the dataset states for a song of this name, whose samples are others (--bpm sets it)",
    }
    return (
        f"{text}; tempo {tempo:g} BPM, {phrases[record['tempo_from']]}" if record["tempo_from"] in phrases else text
    )


def _dataset_like(like: str) -> Store | None:
    return open_store(like) if (Path(like) / DATASET_FILE).exists() else None


def _recipe_like(like: str) -> Recipe:
    folder = Path(like)
    if not folder.is_dir():
        try:
            return load_recipe(like)
        except UsageError as error:
            if not folder.exists() and folder.suffix not in (".yaml", ".yml"):
                error.problem = f"there is neither a dataset folder nor a recipe {shown(like)}"
            raise
    store = open_store(folder)
    recipe = stored_recipe(store)
    if json_sha256(recipe.document) != json_sha256(store.info["recipe"]):
        raise StoreError("the dataset's recipe reads differently in this version of dancedata", where=folder)
    return recipe
