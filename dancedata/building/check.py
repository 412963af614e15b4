"""dancedata check: a built dataset against its dataset.json, or a source folder file by file."""

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.building.arguments import RecipeLike, chosen_recipe, jobs_of
from dancedata.building.build import workers_for
from dancedata.building.clips import compute_clips, sources_of
from dancedata.building.fields.motion import RepresentationField
from dancedata.building.leaks import alike_between, leaks, sound_field
from dancedata.building.left_out import NOTED
from dancedata.building.signals import SignalId
from dancedata.building.sources import scan_source
from dancedata.building.stored import BuiltClips
from dancedata.core.arguments import Overrides
from dancedata.core.bodies import has_body
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.implausible import implausible_problems
from dancedata.core.plugins import Dataset
from dancedata.core.quality import implausible_flags, implausible_sides, music_flags
from dancedata.core.registry import DATASETS
from dancedata.core.rejects import reject_on_error, relative_to
from dancedata.core.sides import sampled
from dancedata.core.text import counted, listed
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from dancedata.files.addresses import local_folder
from dancedata.files.atomic import PREFIX
from dancedata.music.silence import noted
from dancedata.recipes.parse import stored_recipe
from dancedata.recipes.recipe import Recipe, resolve
from dancedata.store import Problem, Signal, Store, open_store, verify_store
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.schema import DATASET_FILE, PUBLICATION_FILE, is_shard_name
from dancedata.store.songs import music_hash, songs_of

#: Clip, seconds of its motion, seconds of its music; and how many of them a note shows.
_Length = tuple[str, float, float]
_LENGTHS = 8


def check(
    path: str | Path,
    *others: str | Path,
    dataset: str | None = None,
    recipe: RecipeLike | None = None,
    overrides: Overrides = (),
    jobs: int | None = 1,
    progress: bool = True,
) -> list[Problem]:
    """Check a built dataset or a source folder, as ``dancedata check`` does.

    Parameters
    ----------
    path
        Folder that `build` wrote or the address of one, or a folder to build from.
    others
        Further folders that `build` wrote: each is checked, and then what any two of them share, such as a song that
        train of one and test of another have.
    dataset
        Reader of a source folder, such as "aist++". Default: the first one that recognises it.
    recipe, overrides
        Read a source folder as this recipe does. Default: recipe.yaml in the folder, if `dataset` is not given.
    jobs
        Worker processes for a source folder; None: one per core.
    progress
        As in `build`.

    Returns
    -------
    list of Problem
        Each with `severity` ("error" or "note"), `where` and `message`. Without an error the folder is sound.

    Raises
    ------
    UsageError
        For an unknown dataset or recipe.
    SourceError
        If the folder is neither a built dataset nor a source of a known one.

    Examples
    --------
    >>> import dancedata
    >>> [problem for problem in dancedata.check("data/aistpp") if problem.severity == "error"]
    []
    """
    folder, *further = [local_folder(p) for p in (path, *others)]
    reporter, jobs = Progress(quiet=not progress), jobs_of(jobs)
    if further:
        if recipe is not None or dataset is not None or overrides:
            raise UsageError("built datasets are compared, which have no reader", fix="leave out dataset and recipe")
        return _check_several([folder, *further])
    parsed = chosen_recipe(path, recipe, dataset, overrides)
    if dataset is None and parsed is None and folder.is_dir() and any(_is_built(p.name) for p in folder.iterdir()):
        return _check_built(folder)
    _require_folder(folder)
    if parsed is not None:
        return _check_as_built(parsed, folder, jobs, reporter)
    return _check_source(folder, dataset, jobs, reporter)


def _check_source(path: Path, dataset: str | None, jobs: int, progress: Progress) -> list[Problem]:
    """Check a source file by file, as its reader scans it."""
    reader, scan = scan_folder(path, dataset)
    problems = [Problem("note", str(path), note) for note in scan.notes]
    problems += [_problem(r) for r in scan.rejects]
    calls = [(reader, ref) for ref in scan.clips]
    checked = run_units(_check_clip, calls, jobs=jobs, label="checking", progress=progress)
    problems += _lengths_note(path, [length for _, length in checked if length is not None])
    problems += [_problem(reject) for rejects, _ in checked for reject in rejects]
    left_out = [reject for rejects, _ in checked for reject in rejects if reject.reason not in NOTED]
    usable = {clip.id for clip in scan.clips} - {reject.clip for reject in left_out}
    return problems + _nothing_usable(path, usable, [*scan.rejects, *left_out])


def _nothing_usable(path: Path, usable: Collection[str], rejects: Sequence[Reject]) -> list[Problem]:
    """Return the error of a source of which no clip can be used, with the reasons in one sentence."""
    if usable:
        return []
    counts = Counter(reject.reason for reject in rejects)
    reasons = ", ".join(f"{n} {reason}" for reason, n in counts.most_common()) or "none is listed"
    return [Problem("error", str(path), f"no clip is left that can be used: {reasons}")]


def _lengths_note(path: Path, lengths: Sequence[_Length]) -> list[Problem]:
    """Return the note with the lengths of motion and music side by side, the largest differences first."""
    ordered = sorted(lengths, key=lambda length: (-abs(length[1] - length[2]), length[0]))
    sides = [f"{clip} {motion:.2f} and {music:.2f}" for clip, motion, music in ordered]
    text = f"Seconds of motion and music, the largest differences first: {listed(sides, _LENGTHS)}."
    return [Problem("note", str(path), text)] if sides else []


def _check_as_built(recipe: Recipe, path: Path, jobs: int, progress: Progress) -> list[Problem]:
    """Run the stages of a build up to what would be stored, in the cache; features of networks are not computed."""
    source = path.absolute()
    _require_files(recipe.dataset, source)
    build_cache = Cache.at()
    recipe = resolve(recipe, build_cache.file_sha256)
    scan = scan_source(recipe.dataset, recipe.parts.fields, source)

    def examined(cache: Cache) -> BuiltClips:
        sources = sources_of(cache, recipe, scan, jobs=workers, progress=progress)
        return compute_clips(cache, recipe, sources, jobs=workers, progress=progress, networks=False)

    with workers_for(recipe, source, build_cache, jobs) as workers:
        clips, rejects, quality = build_cache.retry_lost(examined, progress)
    usable = {clip.id for clip in clips}
    originals = [clip for clip in clips if not clip.source and clip.signal is not None]
    lengths = [(c.id, float(recipe.grid.seconds(c.n_frames)), _seconds(c.signal)) for c in originals]
    networks = [field.name for field in recipe.fields if field.lane]
    notes = [*scan.notes, *([f"not computed, so not checked: {listed(networks)}"] if networks else [])]
    problems = [Problem("note", str(path), note) for note in notes] + _lengths_note(path, lengths)
    by_reason = defaultdict(list)
    for reject in rejects:
        file = reject.file if reject.window is None else ""
        by_reason[reject.reason, reject.clip, file].append(relative_to(reject, source))
    for alike in by_reason.values():
        windows = sum(reject.window is not None for reject in alike)
        of_clip = next((reject for reject in alike if reject.window is None), alike[0])
        more = f" ({counted(windows, 'window')})" if windows else ""
        problems.append(_problem(replace(of_clip, detail=(of_clip.detail or of_clip.file) + more)))
    problems += [_problem(reject) for reject in implausible_problems(quality)]
    return problems + _nothing_usable(path, usable, rejects)


def _check_several(paths: Sequence[Path]) -> list[Problem]:
    """Check datasets, and find what they share, pair by pair: songs by samples, sound and name, recordings, dancers.

    Music that train of one shares with val or test of another is an error, unless both have official splits.
    """
    problems = [problem for path in paths for problem in _check_built(path)]
    if any(problem.severity == "error" for problem in problems):
        return problems
    with ExitStack() as opened:
        stores = [opened.enter_context(open_store(path)) for path in paths]
        for one, other in itertools.combinations(stores, 2):
            problems += _shared(one, other)
    return problems


def _check_built(path: Path) -> list[Problem]:
    problems = verify_store(path)
    if not any(p.severity == "error" for p in problems):
        problems += [*leaks(path), *_implausible(path)]
    return problems


def _shared(one: Store, other: Store) -> Iterator[Problem]:
    where = f"{one.path} and {other.path}"
    official = all(store.info.get("source", {}).get("split_rule") == "official" for store in (one, other))
    songs = [songs_of(store.clips()) for store in (one, other)]
    by_samples = [_splits_by(store, music_hash) for store in (one, other)]
    label = [
        {music_hash(clip): of_clip[clip.id] for clip in store if clip.id in of_clip}
        for store, of_clip in zip((one, other), songs, strict=True)
    ]
    equal = {(label[0][key], label[1][key]) for key in by_samples[0].keys() & by_samples[1].keys()}
    for splits, keys in _by_splits(*by_samples):
        names = [_both(label[0][key], label[1][key]) for key in keys]
        leaks = "train" in splits and splits != ("train", "train") and not official
        message = f"{splits[0]} and {splits[1]} share {counted(len(names), 'song')}, by samples: {listed(names)}"
        yield Problem("error" if leaks else "note", where, message)
    alike = alike_between(one, other, equal)
    if isinstance(alike, str):
        yield Problem("note", where, f"songs were compared by samples and name, not by their sound: {alike}")
    for pair in alike if not isinstance(alike, str) else ():
        # Each has splits of its own here.
        leaks = any("train" in splits for splits in pair.splits) and set().union(*pair.splits) != {"train"}
        yield Problem("error" if leaks and not official else "note", where, pair.message)
    for kind, key_of in (("song", "music"), ("recording", "original"), ("dancer", "dancer")):
        for splits, names in _by_splits(*(_splits_by(store, attrgetter(key_of)) for store in (one, other))):
            message = f"{splits[0]} and {splits[1]} share {counted(len(names), kind)}, by name alone: {listed(names)}"
            yield Problem("note", where, message)


def _splits_by(store: Store, key_of: Callable[[ClipRecord], str]) -> dict[str, set[str]]:
    """Return the splits of each key of the clips; clips without one do not count."""
    splits = defaultdict(set)
    for clip in store:
        splits[key_of(clip)].add(clip.split)
    return {key: of_key for key, of_key in splits.items() if key}


def _by_splits(one: Mapping[str, set[str]], other: Mapping[str, set[str]]) -> list[tuple[tuple[str, str], list[str]]]:
    """Return the keys of both datasets, for each pair of a split of one and a split of the other."""
    pairs = defaultdict(list)
    for key in sorted(one.keys() & other.keys()):
        for splits in itertools.product(one[key], other[key]):
            pairs[splits].append(key)
    return sorted(pairs.items())


def _both(one: str, other: str) -> str:
    return one if one == other else f"{one} (there {other})"


def _implausible(path: Path) -> list[Problem]:
    """Return notes on implausible clips of a sound dataset by its flags and today's rules, and on songs."""
    with open_store(path) as store:
        flagged = {(row.get("clip"), row.get("kind")) for row in store.quality}
        rows = store.quality + [row for row in _side_rows(store) if (row["clip"], row["kind"]) not in flagged]
        notes = [Problem("note", p.clip, f"{p.reason}: {p.detail}") for p in implausible_problems(rows)]
        audio = [name for name in store.fields if store.field(name).kind == "audio"]
        if audio and len(store.splits) > 1 and sound_field(store) is None:
            why = f"{listed(audio)} has no MFCC and chroma, as librosa35 has"
            message = f"songs of splits were compared by name and samples, not by their sound: {why}"
            notes.append(Problem("note", str(path), message))
        return notes


def _side_rows(store: Store) -> Iterator[dict[str, Any]]:
    """Yield rows, as in quality.jsonl, about left, right and up of the stored motion."""
    field = _field_with_body(store)
    if field is None:
        return
    for clip in (clip for clip in store if (field.name in clip)):
        try:
            sides = _sides(field, sampled(clip.read(field.name)))
        except DanceDataError:
            continue  # finite, but not columns of a body
        yield from ({"clip": clip.id, "kind": kind, "value": value} for kind, value in sides)


def _sides(field: RepresentationField, columns: npt.NDArray[Any]) -> list[tuple[str, float]]:
    representation = field.representation
    if representation.decodes:
        motion = representation.decode(columns, field.grid)
        return implausible_sides(motion.joints(), None if representation.positions_only else motion)
    places = columns[:, representation.columns.slice("position")].reshape(len(columns), -1, 3)
    return implausible_sides(places.astype(np.float64))


def _field_with_body(store: Store) -> RepresentationField | None:
    """Return the most informative field of SMPL's joints: rotations, else positions; None without one."""
    try:
        recipe = stored_recipe(store)
    except DanceDataError:
        return None  # its plug-ins are not installed
    fields = [
        motion_field
        for motion_field in recipe.motion
        if motion_field.name in store.fields
        and has_body(motion_field.representation.skeleton)
        and (motion_field.representation.decodes or "position" in motion_field.representation.columns.names)
    ]
    return min(fields, key=lambda f: (f.representation.positions_only, not f.representation.decodes), default=None)


def _is_built(name: str) -> bool:
    return name in (DATASET_FILE, PUBLICATION_FILE) or is_shard_name(name) or name.startswith(PREFIX)


def scan_folder(path: Path, dataset: str | Dataset | None = None) -> tuple[Dataset, Scan]:
    """Return a reader and its scan of a folder; by default the first that recognises it, else SourceError."""
    if dataset is not None:
        reader = DATASETS.get(dataset)() if isinstance(dataset, str) else dataset
        _require_files(reader, path)
        return reader, reader.scan(path)
    _require_folder(path)
    failures: list[tuple[type[Dataset], SourceError]] = []
    # A generator would fill this folder. A reader for any files comes last, and only where the folder has a list for
    # it: it would take a copy of a supported dataset that the dataset's reader refuses.
    readers = [cls for cls in map(DATASETS.get, DATASETS.names()) if not cls.generates]
    for cls in sorted(readers, key=lambda cls: cls.explicit_only):
        reason = SourceError(f"accepts any layout; select it with --recipe {cls.name}")
        if not cls.explicit_only or cls.has_listing(path):
            reader = cls()
            try:
                return reader, reader.scan(path)
            except SourceError as error:
                reason = error
        failures.append((cls, reason))
    failures.sort(key=lambda failure: not failure[0].explicit_only)  # the user's own files first
    # What most readers found is the names of the folder's files: it is named once.
    founds = Counter(str(error.found) for _, error in failures if error.found is not None)
    common = next((found for found, times in founds.most_common(1) if times > 1), None)
    lines = "".join(f"\n  - {cls.name}: {_reason(cls, error, common)}" for cls, error in failures)
    listing = "" if common is None else f"; found {common}"
    raise SourceError(f"this is neither a built dataset nor a source folder of a known one{listing}:{lines}")


def _reason(cls: type[Dataset], error: SourceError, common: str | None) -> str:
    if error.found is None or str(error.found) != common:
        return str(error)
    return str(SourceError(error.problem.removeprefix(f"{cls.name}: "), allowed=error.allowed, fix=error.fix))


def _require_folder(path: Path) -> None:
    if not path.is_dir():
        problem, fix = "the folder does not exist", ""
        if path.exists():
            problem, fix = "this is not a folder", "to read one file: dancedata view FILE"
        raise SourceError(problem, where=path, allowed="a built dataset, or a folder to build from", fix=fix)


def _require_files(reader: Dataset, path: Path) -> None:
    """Raise SourceError for a folder that a reader's scan would fill."""
    if reader.generates and not (path.is_dir() and any(path.iterdir())):
        raise SourceError("there is nothing to check", where=path, found="no folder, or an empty one")


def _seconds(signal: SignalId | Signal | None) -> float:
    return 0.0 if signal is None else signal.n_samples / signal.sample_rate


def _check_clip(reader: Dataset, ref: ClipRef) -> tuple[list[Reject], _Length | None]:
    from dancedata.music.signal import load_audio

    motion = reject_on_error(lambda: reader.load(ref), ref.motion_path, ref.id)
    if isinstance(motion, Reject):
        problems = [motion]
    else:
        problems = implausible_problems({"clip": ref.id, **flag.to_json()} for flag in implausible_flags(motion))
    song = ref.audio_path
    music = None if song is None else reject_on_error(lambda: load_audio(song), song, ref.id)
    problems += [music] if isinstance(music, Reject) else []
    if music is None or isinstance(music, Reject) or isinstance(motion, Reject):
        return problems, None
    seconds = motion.grid.seconds(motion.n_frames)
    of_music = music_flags(noted(music, ref.audio_start, seconds))
    problems += implausible_problems({"clip": ref.id, **flag.to_json()} for flag in of_music)
    return problems, (ref.id, float(seconds), len(music.samples) / music.sample_rate)


def _problem(reject: Reject) -> Problem:
    severity: Literal["error", "note"] = "note" if reject.reason in NOTED else "error"
    fix = f"; {reject.fix}" if reject.fix else ""
    return Problem(severity, reject.clip or reject.file, f"{reject.reason}: {reject.detail or reject.file}{fix}")
