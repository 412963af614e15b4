"""dancedata build: one recipe, one source, one dataset."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.building.card import dataset_card
from dancedata.building.clips import compute_clips, sources_of
from dancedata.building.left_out import empty_build_error, reasons, require_no_rejects
from dancedata.building.out_folder import check_out, locked, new_dataset
from dancedata.building.signals import libsndfile_version
from dancedata.building.source_record import SourceRecord
from dancedata.building.sources import Sources, scan_source
from dancedata.building.stored import BuiltClips
from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import UsageError
from dancedata.core.packages import package_version
from dancedata.core.rejects import relative_to
from dancedata.core.text import counted
from dancedata.core.version import __version__
from dancedata.execution.arithmetic import expected
from dancedata.execution.cache import Cache
from dancedata.execution.executors import Executor
from dancedata.execution.progress import Progress
from dancedata.execution.units import engine_of, start_workers
from dancedata.files.atomic import write_json
from dancedata.files.cache_files import running, sweep
from dancedata.recipes.recipe import Recipe, resolve
from dancedata.store import Field, Store, StoreHeader, open_store, write_store
from dancedata.store.schema import DATASET_FILE, LOCAL_FILE
from dancedata.store.songs import songs_of

if TYPE_CHECKING:
    from dancedata.building.rebuild import Publication
    from dancedata.store import Problem


@dataclass(frozen=True)
class BuildResult:
    """The result of a build, as dataset.json has it."""

    path: Path
    built: bool  # False if the dataset existed already
    counts: Mapping[str, Mapping[str, Any]]  # per split: clips, windows, songs, hours of motion
    left_out: Mapping[str, int]  # files, clips and windows, by reason
    notes: tuple[str, ...]
    strict: bool = False  # whether shared songs count for a dataset that existed, too
    rebuilt: bool | None = None  # whether the bytes are those of a publication
    compared: str = ""  # a line on that

    @classmethod
    def of(cls, path: Path, built: bool, strict: bool) -> BuildResult:
        """Describe a finished dataset."""
        with open_store(path) as store:
            counts, left_out = dict(store.info["splits"]), reasons(store)
            notes = tuple(store.info.get("source", {}).get("notes", ()))
        return cls(path, built, counts, left_out, notes, strict)

    @cached_property
    def shared(self) -> tuple[Problem, ...] | None:
        """Problems with songs that splits share, as `check` finds them; None where that does not count."""
        from dancedata.building.leaks import leaks

        return tuple(leaks(self.path)) if self.built or self.strict else None

    @cached_property
    def summary(self) -> str:
        """The text that the command line prints."""
        from dancedata.building.describe import describe_built, describe_unchanged
        from dancedata.building.leaks import checked_lines

        checked = [] if self.shared is None else checked_lines(self.counts, self.shared)
        described = describe_built(self.path, checked) if self.built else describe_unchanged(self.path, checked)
        return "\n".join(filter(None, (described, self.compared)))

    def __repr__(self) -> str:
        clips, windows = (sum(n[key] for n in self.counts.values()) for key in ("clips", "windows"))
        size = f"{counted(clips, 'clip')}, {counted(windows, 'window')}, {sum(self.left_out.values()):,} left out"
        return f"BuildResult({str(self.path)!r}, {size}, built={self.built})"

    def open(self) -> Store:
        """Open the dataset, as `dancedata.open` does."""
        return open_store(self.path)


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
    backend: str | None = None,
    scheduler: str | None = None,
    published: Publication | None = None,
) -> BuildResult:
    """Build a dataset from a parsed recipe; with `published`, compare it with those of a publication."""
    progress = progress or Progress(quiet=True)
    engine_of(backend, scheduler)
    if overwrite and Path.cwd().is_relative_to(out.resolve()):
        raise UsageError(
            "cannot replace the current working directory", where=out, fix="build from another working folder"
        )
    header_of(recipe, {}).check()  # now, not after everything is computed
    source = source.absolute()  # so that it can be found in the text of rejects
    build_cache = Cache.at(cache)
    recipe = resolve(recipe, build_cache.file_sha256)

    def run(cache: Cache) -> bool:
        """Build with `workers` what `scan` has listed; return False if the dataset existed already."""
        sources = sources_of(cache, recipe, scan, jobs=workers, progress=progress)
        record = SourceRecord.of_source(sources, source)
        if published is not None:
            published.warn(sources.sha256, record, progress)
        if (out / DATASET_FILE).exists() and not overwrite:
            from dancedata.building.differences import require_same

            require_same(out, recipe, sources.sha256, record)
            with open_store(out) as store:
                require_no_rejects(strict, [Reject.from_json(row) for row in store.rejects], scan, store.quality)
            return False
        require_no_rejects(strict, sources.rejects, scan)
        computed = compute_clips(cache, recipe, sources, jobs=workers, progress=progress)
        require_no_rejects(strict, computed.rejects, scan, computed.quality)
        computed = computed._replace(rejects=[relative_to(r, source) for r in computed.rejects])
        if not computed.clips:
            raise empty_build_error(source, recipe.dataset, scan, computed.rejects)
        meta = _meta(recipe, sources, record.to_json({clip.original for clip in computed.clips}))
        with new_dataset(out) as folder:
            _write(folder, recipe, scan, computed, meta, progress)
            place = os.path.relpath(source, out.absolute())
            write_json(folder / LOCAL_FILE, {"source": Path(place).as_posix()})
        return True

    with locked(out):
        check_out(out, overwrite=overwrite)
        scan = scan_source(recipe.dataset, recipe.parts.fields, source)
        with workers_for(recipe, source, build_cache, jobs, backend, scheduler) as workers:
            result = BuildResult.of(out, build_cache.retry_lost(run, progress), strict)
        if published is None:
            return result
        same = published.same(out)
        line = f"{'the same bytes as' if same else 'other bytes than'} {published.place}"
        return replace(result, rebuilt=same, compared=line)


@contextmanager
def workers_for(
    recipe: Recipe, source: Path, cache: Cache, jobs: int, backend: str | None = None, scheduler: str | None = None
) -> Iterator[Executor]:
    """Start workers for a recipe, see `start_workers`; first sweep leftovers of killed processes out of the cache."""
    sweep(cache.root)
    packages = {name for field in recipe.fields for name in field.packages}
    started = start_workers(jobs, cache, source, packages, backend=backend, scheduler=scheduler)
    with running(cache.root), started as workers:
        yield workers


def header_of(recipe: Recipe, meta: Mapping[str, Any]) -> StoreHeader:
    """Return the header of the store."""
    return StoreHeader(
        fps=recipe.fps,
        length=recipe.windows.length,
        stride=recipe.windows.stride,
        fields=tuple(
            Field(f.name, f.kind, f.columns, f.grid.rate, f.dtype, f.codebook, optional=f.optional, axes=f.axes)
            for f in recipe.fields
        ),
        skeleton=recipe.skeleton,
        meta=meta,
    )


def _write(
    out: Path, recipe: Recipe, scan: Scan, computed: BuiltClips, meta: Mapping[str, Any], progress: Progress
) -> None:
    with progress.stage("writing", len(computed.clips)) as advance:
        write_store(
            out,
            header_of(recipe, meta),
            computed.clips,
            rejects=sorted(
                computed.rejects, key=lambda r: (r.clip, -1 if r.window is None else r.window, r.reason, r.file)
            ),
            quality=computed.quality,
            shard_bytes=recipe.shard_mb * 2**20,
            card=dataset_card(recipe, scan, computed, songs_of(computed.clips), _networks(recipe)),
            progress=lambda done, total: advance(1),
        )


def _meta(recipe: Recipe, sources: Sources, unstored: Mapping[str, str]) -> dict[str, Any]:
    packages = {"numpy", "scipy", "h5py", "soundfile"}
    decoders = {clip.signal.ffmpeg for clip in sources.clips if clip.signal and clip.signal.ffmpeg}
    versions = {"libsndfile": libsndfile_version(), **({"ffmpeg": max(decoders)} if decoders else {})}
    packages.update(name for field in recipe.fields for name in field.packages)
    # The folder of a file does not matter.
    local = {name: {"file": file.path.name, "sha256": file.sha256} for name, file in recipe.plugin_files.items()}
    return {
        "name": recipe.name,
        "recipe": recipe.document,
        "source": {
            "reader": recipe.dataset.name,
            "sha256": sources.sha256,
            **({"split_rule": "official"} if recipe.dataset.official_split else {}),
            "layout": sources.scan.layout,
            "notes": [*sources.scan.notes, *recipe.notes({ref.split for ref in sources.scan.clips})],
            "clips": dict(unstored),
            "content": sources.named_files,
        },
        "licence": recipe.dataset.licence,
        "citation": recipe.dataset.citation,
        "genre_ids": dict(sources.scan.genre_ids or recipe.dataset.genre_ids),
        **({"encoders": networks} if (networks := _networks(recipe)) else {}),
        "versions": {
            "dancedata": __version__,
            "arithmetic": expected(),
            **versions,
            **{name: package_version(name) for name in sorted(packages)},
            **({"plugins": local} if local else {}),
        },
    }


def _networks(recipe: Recipe) -> dict[str, Any]:
    """Return the statements of audio fields on their networks, by field."""
    return {field.name: dict(field.about) for field in recipe.fields if field.about}
