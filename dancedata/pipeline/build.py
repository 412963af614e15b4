"""dancedata build: one recipe, one source, one dataset of format 1."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import DataError, StoreError, UsageError
from dancedata.core.version import __version__
from dancedata.pipeline.audio_units import libsndfile_version
from dancedata.pipeline.cache import Cache, default_cache, package_version
from dancedata.pipeline.card import dataset_card
from dancedata.pipeline.execute import Progress
from dancedata.pipeline.gather import Gathered, gather, identify, require_clips
from dancedata.pipeline.recipe import Recipe
from dancedata.store import Field, StoredClip, StoreHeader, open_store, write_store
from dancedata.store.schema import (
    CARD_FILE,
    DATASET_FILE,
    QUALITY_FILE,
    REJECTS_FILE,
    STATS_FILE,
    is_shard_name,
)

LOCK_FILE = ".lock"
_OWN_FILES = {DATASET_FILE, STATS_FILE, REJECTS_FILE, QUALITY_FILE, CARD_FILE, LOCK_FILE}
#: Reasons for which a clip is left out by choice; they do not stop a strict build.
BY_CHOICE = {"ignored", "unassigned", "missing_motion", "unused_music", "extra_file", "no_audio", "still"}


@dataclass(frozen=True)
class BuildResult:
    """What a build did.

    Attributes
    ----------
    built
        False if the dataset was there already and nothing had to be done.
    scan_notes
        What the dataset reader had to say.
    """

    out: Path
    built: bool
    scan_notes: tuple[str, ...]


def build(
    recipe: Recipe,
    source: Path,
    out: Path,
    *,
    jobs: int = 1,
    overwrite: bool = False,
    strict: bool = False,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build a dataset.

    Parameters
    ----------
    source, out
        Folder to read and folder to write; `out` is made if it is missing.
    jobs
        Worker processes. The result does not depend on it.
    overwrite
        Build beside a dataset that is in `out`, then swap.
    strict
        Stop at the first broken clip instead of setting it aside.
    cache
        Folder of the cache; default: $DANCEDATA_CACHE, else the user's cache folder.

    Raises
    ------
    SourceError, StoreError
        If the source or `out` cannot be used.
    DataError
        With `strict`, for the first broken clip.
    """
    progress = progress or Progress(quiet=True)
    if overwrite and Path.cwd().is_relative_to(out.resolve()):
        raise UsageError(
            "a folder that one stands in cannot be swapped", where=out, fix="build from another working folder"
        )
    header_of(recipe, {}).check()
    source = source.absolute()  # so that it can be told from other text in what rejects say
    store_cache = Cache((cache or default_cache()).absolute())
    with _locked(out):
        _check_out(out)
        scan: Scan = recipe.dataset.scan(source)
        gathered = identify(store_cache, recipe, scan, jobs=jobs, progress=progress)
        source_sha256 = gathered.source_sha256()
        if (out / DATASET_FILE).exists() and not overwrite:
            _require_same(out, recipe, source_sha256)
            _stop_if_strict(strict, _rejects_there(out))
            return BuildResult(out, built=False, scan_notes=scan.notes)
        _stop_if_strict(strict, [*gathered.rejects, *gathered.audio_problems.values()])
        clips = gather(store_cache, gathered, jobs=jobs, progress=progress)
        _stop_if_strict(strict, gathered.rejects)
        require_clips(clips, gathered.rejects)
        gathered.rejects = [_relative(r, source) for r in gathered.rejects]
        if (out / DATASET_FILE).exists():
            with _swapped(out) as fresh:
                _write(fresh, recipe, gathered, clips, source_sha256, progress)
        else:
            _clean(out)
            _write(out, recipe, gathered, clips, source_sha256, progress)
    return BuildResult(out, built=True, scan_notes=scan.notes)


def header_of(recipe: Recipe, meta: Mapping[str, Any]) -> StoreHeader:
    """Return what holds for the whole store."""
    motion = [Field(s.name, "motion", s.representation.columns, recipe.grid_of(s).rate) for s in recipe.motion]
    keymotion = [Field(k.name, "keymotion", k.columns, recipe.fps) for k in recipe.keymotion]
    audio = [Field(f.name, "audio", f.columns, recipe.fps, f.dtype) for f in recipe.audio]
    return StoreHeader(
        scope=recipe.scope,
        fps=recipe.fps,
        length=recipe.windows.length,
        stride=recipe.windows.stride,
        order=recipe.windows.order,
        fields=(*motion, *keymotion, *audio),
        skeleton=max((s.representation.skeleton for s in recipe.motion), key=lambda s: s.n_joints),
        meta=meta,
    )


def _write(
    out: Path,
    recipe: Recipe,
    gathered: Gathered,
    clips: list[StoredClip],
    source_sha256: str,
    progress: Progress,
) -> None:
    meta = _meta(recipe, gathered, source_sha256)
    with progress.stage("writing", len(clips)) as advance:
        write_store(
            out,
            header_of(recipe, meta),
            clips,
            rejects=sorted(gathered.rejects, key=_reject_order),
            quality=gathered.quality,
            shard_bytes=recipe.shard_mb * 2**20,
            card=dataset_card(recipe, gathered, clips),
            progress=lambda done, total: advance(1),
        )


def _meta(recipe: Recipe, gathered: Gathered, source_sha256: str) -> dict[str, Any]:
    packages = {"numpy", "scipy", "h5py", "soundfile"}
    versions = {"libsndfile": libsndfile_version()}
    packages.update(name for feature in recipe.audio for name in feature.packages)
    return {
        "name": recipe.name,
        "dancedata": __version__,
        "recipe": recipe.document,
        "recipe_sha256": recipe.sha256,
        "source_sha256": source_sha256,
        "source": {"layout": gathered.scan.layout, "notes": list(gathered.scan.notes)},
        "dataset": recipe.dataset.name,
        "licence": recipe.dataset.licence,
        "citation": recipe.dataset.citation,
        "axes": {slot.name: slot.representation.axes for slot in recipe.motion},
        "rotation_6d": {slot.name: slot.representation.rotation_6d for slot in recipe.motion},
        "skeletons": {slot.name: slot.representation.skeleton.name for slot in recipe.motion},
        "genre_ids": dict(getattr(recipe.dataset, "genre_ids", {})),
        "content": gathered.content,
        "packages": {**versions, **{name: package_version(name) for name in sorted(packages)}},
        "quality_flags": len(gathered.quality),
    }


def _require_same(out: Path, recipe: Recipe, source_sha256: str) -> None:
    """Raise StoreError with the difference, if `out` was made by another recipe or from another source."""
    meta = open_store(out).meta
    differences = list(_differences(meta.get("recipe", {}), recipe.document))
    if meta.get("recipe_sha256") != recipe.sha256:
        listed = "\n".join(f"  - {d}" for d in differences) or "  - (another version of dancedata)"
        raise StoreError(
            "the dataset there was made by another recipe",
            where=out,
            found=f"these differences:\n{listed}\n",
            fix="choose another --out, or --overwrite to replace it",
        )
    if meta.get("source_sha256") != source_sha256:
        raise StoreError(
            "the dataset there was made from another source: files, splits or metadata of its clips differ",
            where=out,
            found=f"source {source_sha256[:12]}, built from {str(meta.get('source_sha256'))[:12]}",
            fix="choose another --out, or --overwrite to build it anew (only what changed is computed)",
        )


def _differences(old: Any, new: Any, at: str = "") -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            if at == "" and key in ("name", "description"):
                continue
            yield from _differences(old.get(key), new.get(key), f"{at}.{key}" if at else str(key))
    elif old != new:
        yield f"{at}: {json.dumps(old)} there, {json.dumps(new)} now"


def _reject_order(reject: Reject) -> tuple[str, int, str, str]:
    return reject.clip, -1 if reject.window is None else reject.window, reject.reason, reject.file


def _rejects_there(out: Path) -> list[Reject]:
    with open_store(out) as store:
        return [Reject(**row) for row in store.rejects]


def _relative(reject: Reject, source: Path) -> Reject:
    """Name files relative to the source: where it lies shapes no byte of a dataset."""
    prefix = f"{source}{os.sep}"
    return replace(reject, file=reject.file.removeprefix(prefix), detail=reject.detail.replace(prefix, ""))


def _stop_if_strict(strict: bool, rejects: Sequence[Reject]) -> None:
    broken = [r for r in rejects if r.reason not in BY_CHOICE]
    if strict and broken:
        first = broken[0]
        raise DataError(
            f"{len(broken)} broken clip{'s' * (len(broken) != 1)} in a strict build, the first: {first.detail}",
            reason=first.reason,
            where=first.clip or first.file,
            fix="mend or remove it, or build without --strict to set it aside",
        )


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Make `out` and hold its lock; a second writer fails at once."""
    with _writing(out):
        _recover(out)
    made = not out.exists()
    lock = FileLock(out / LOCK_FILE, timeout=0)
    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire()
        except Timeout as error:
            raise StoreError(
                "another build is writing there", where=out, fix="wait until it has ended, or choose another --out"
            ) from error
    try:
        yield
    finally:
        # Unlinked while it is held: a finished dataset holds no stray file.
        with suppress(OSError):
            (out / LOCK_FILE).unlink()
        lock.release()
        if made:
            with suppress(OSError):
                out.rmdir()  # which fails unless nothing was built


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    """Turn errors of the file system into one that names the output folder."""
    try:
        yield
    except OSError as error:
        raise _unwritable(out, error) from error


def _unwritable(out: Path, error: OSError) -> StoreError:
    return StoreError(
        "the output folder cannot be written",
        where=out,
        found=str(error),
        fix="choose an --out that is a folder of your own, on a disk with room",
    )


def _check_out(out: Path) -> None:
    names = sorted(p.name for p in out.iterdir())
    # Shards are written first and removed last: a README.md alone is somebody else's.
    ours = any(name == DATASET_FILE or is_shard_name(name) for name in names)
    own = _OWN_FILES if ours else {LOCK_FILE}
    foreign = [n for n in names if n not in own and not is_shard_name(n) and not _is_temporary(n)]
    if foreign:
        shown = ", ".join(foreign[:5]) + (", ..." if len(foreign) > 5 else "")
        raise StoreError(
            "the output folder holds files that are not dancedata's",
            where=out,
            found=shown,
            allowed="an empty folder, a new one, or a dataset built before",
            fix="choose another --out; nothing was written",
        )


def _is_temporary(name: str) -> bool:
    """Tell whether a file is one that `atomic_file` was writing when it was killed."""
    return name.startswith(".") and name.endswith(".tmp")


def _clean(out: Path) -> None:
    """Remove what a killed build left: without dataset.json none of it counts."""
    with _writing(out):
        for path in sorted(out.iterdir(), key=lambda p: is_shard_name(p.name)):
            if path.name != LOCK_FILE:
                path.unlink()
        for folder in _beside(out):
            shutil.rmtree(folder, ignore_errors=True)


def _beside(out: Path) -> tuple[Path, Path]:
    """Return the folders of a swap: the new dataset before it, the old one after it."""
    real = out.resolve()
    return real.parent / f".{real.name}.new", real.parent / f".{real.name}.old"


def _recover(out: Path) -> None:
    """Put the old dataset back where a swap was killed half way."""
    fresh, old = _beside(out)
    if not out.exists() and (old / DATASET_FILE).exists():
        os.rename(old, out)
        shutil.rmtree(fresh, ignore_errors=True)


@contextmanager
def _swapped(out: Path) -> Iterator[Path]:
    """Give a fresh folder beside `out`; on success it takes its place."""
    fresh, old = _beside(out)
    with _writing(out):
        for folder in (fresh, old):
            shutil.rmtree(folder, ignore_errors=True)
        fresh.mkdir()
    try:
        yield fresh
        with _writing(out):
            real = out.resolve()
            # The same lock in the new folder, so that no second writer gets in between; not every file system
            # knows hard links.
            with suppress(OSError):
                os.link(real / LOCK_FILE, fresh / LOCK_FILE)
            os.rename(real, old)
            os.rename(fresh, real)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)
