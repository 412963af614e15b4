"""dancedata build --dry-run: the outcome of a build, from lengths alone; computes no feature, writes no dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from dancedata.building.annotators.vitals import VITALS, Vitals
from dancedata.building.arguments import BuildArguments, RecipeLike, jobs_of
from dancedata.building.build import header_of
from dancedata.building.clips import source_groups, sources_of
from dancedata.building.compute import compute
from dancedata.building.describe import rate_text
from dancedata.building.groups import whole
from dancedata.building.left_out import empty_build_error
from dancedata.building.measuring import takes_of
from dancedata.building.plugins import Field
from dancedata.building.result import Result
from dancedata.building.signals import SignalId
from dancedata.building.sources import scan_source
from dancedata.building.spine import expand
from dancedata.building.windows import cut_windows
from dancedata.core.arguments import Overrides
from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import SourceError, StoreError, UsageError
from dancedata.core.implausible import describe_implausible
from dancedata.core.left_out import left_out_lines
from dancedata.core.quality import IMPLAUSIBLE
from dancedata.core.rejects import reject_on_error, relative_to
from dancedata.core.tables import table
from dancedata.core.text import counted, listed, shown, size_text
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.recipes.recipe import Recipe
from dancedata.store.schema import sort_splits


class Cached(NamedTuple):
    """The number of a field's units of work, and of those in the cache; equal units count once."""

    unit: str  # "clips", "songs", "slices" or "files"
    cached: int
    of: int


@dataclass(frozen=True)
class Plan:
    """The outcome of a build."""

    recipe: Recipe
    source: Path
    scan: Scan
    results: tuple[Result, ...]  # the takes that it would store, with their windows
    left_out: tuple[Reject, ...]
    cached: Mapping[str, Cached]
    implausible: tuple[Mapping[str, Any], ...]  # flags of clips

    def __repr__(self) -> str:
        clips, windows = (sum(n[key] for n in self._splits().values()) for key in ("clips", "windows"))
        return f"Plan({self.recipe.name!r}, {clips} clips, {windows} windows)"

    @property
    def rejects(self) -> list[Reject]:
        """What would be left out, paths below the source."""
        return [relative_to(reject, self.source) for reject in self.left_out]

    @property
    def problem(self) -> StoreError | None:
        """The error that a build would raise if nothing is left to store."""
        if self.results:
            return None
        return empty_build_error(self.source, self.recipe.dataset, self.scan, self.rejects)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data: counts, columns and bytes."""
        fields = header_of(self.recipe, {}).fields
        return {
            "recipe": self.recipe.document,
            "recipe_sha256": self.recipe.sha256,
            "layout": self.scan.layout,
            "notes": [*self.scan.notes, *self._notes()],
            "splits": self._splits(),
            "fields": {f.name: {"columns": f.columns.width, "dtype": f.dtype} for f in fields},
            "cached": {name: units._asdict() for name, units in self.cached.items()},
            "bytes": self._bytes(),
            "left_out": dict(sorted(Counter(r.reason for r in self.rejects).items())),
        }

    @property
    def summary(self) -> str:
        """The text that the command line prints."""
        return self.describe()

    def describe(self, out: Path | None = None) -> str:
        """Return the plan as text; `out` is named in its first line."""
        document = self.to_json()
        into = "" if out is None else f" into {shown(out)}"
        lines = [
            f"{self.recipe.name}{into}: about {size_text(document['bytes'])}",
            rate_text(str(self.recipe.grid), self.recipe.windows.length, self.recipe.windows.stride),
            *table(
                ["split", "clips", "windows", "frames", "songs"],
                [[s, n["clips"], n["windows"], n["frames"], n["songs"]] for s, n in document["splits"].items()],
            ),
        ]
        for name, field in document["fields"].items():
            held = self.cached[name]
            cached = f"in the cache: {held.cached} of {held.of} {held.unit}"
            lines.append(f"  {name}: {field['columns']} columns, {field['dtype']}; {cached}")
        lines += [line if line.startswith(" ") else f"  would leave out: {line}" for line in self._left_out()]
        return "\n".join([*lines, *(f"  note: {note}" for note in document["notes"])])

    def _splits(self) -> dict[str, dict[str, int]]:
        """Return the numbers of clips, windows, frames and songs by split."""
        splits = {}
        for split in sort_splits({result.take.split for result in self.results}):
            of_split = [result for result in self.results if result.take.split == split]
            sizes = [(len(r.stay), len(r.starts), r.take.time.frames_on(self.recipe.grid)) for r in of_split]
            songs = {r.take.dancers[k].ref.music for r in of_split for k in r.stay}
            splits[split] = {
                "clips": sum(n for n, _, _ in sizes),
                "windows": sum(n * windows for n, windows, _ in sizes),
                "frames": sum(n * frames for n, _, frames in sizes),
                "songs": len(songs - {""}),
            }
        return splits

    def _left_out(self) -> list[str]:
        of_clips = [reject for reject in self.rejects if reject.window is None]
        windows = Counter(reject.reason for reject in self.rejects if reject.window is not None)
        lines = left_out_lines(of_clips)
        lines = [line.replace("  ", "    ", 1) if line.startswith(" ") else line for line in lines]
        return [*lines, *(f"{reason}: {counted(n, 'window')}" for reason, n in sorted(windows.items()))]

    def _notes(self) -> list[str]:
        notes = [line.strip() for line in describe_implausible(self.implausible)]
        rules = self.recipe.parts.rules
        if rules:
            what = listed([rule.name for rule in rules])
            notes.append(f"clips and windows are counted before {what}: rules read what a build computes")
        # A note: where a cluster builds, the weights need not be on the node that plans.
        return notes + [f"a build here ends with: {why}" for why in map(_not_ready, self.recipe.fields) if why]

    def _bytes(self) -> int:
        """Estimate the size of the shards, tables aside; equal songs in several files count each time."""
        total = 0
        for field, in_store in zip(self.recipe.parts.fields, header_of(self.recipe, {}).fields, strict=True):
            rows: dict[tuple[str, str], int] = {}
            for result in self.results:
                for k in result.stay:
                    of = f"clip {result.take.dancers[k].id}" if in_store.per_clip else field.asks(result.take)[k].key
                    rows[result.take.split, of] = field.n_rows(result.take, k)
            total += sum(rows.values()) * in_store.row_bytes
        return total


def make_plan(
    recipe: RecipeLike,
    source: str | Path | None = None,
    out: str | Path | None = None,
    *,
    overrides: Overrides = (),
    jobs: int | None = 1,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Plan:
    """Plan a build, as ``build --dry-run`` does; a generated dataset writes its source if that is missing."""
    arguments = BuildArguments.of(recipe, source, out, overrides)
    reporter, jobs = Progress(quiet=not progress), jobs_of(jobs)
    recipe, source = arguments.recipe, arguments.source
    if not source.exists() and recipe.dataset.generates:
        reporter.write(f"the dataset {recipe.dataset.name} writes its own source: {source}")
    source = source.absolute()  # as in a build, so that messages are the same
    build_cache = Cache.at(cache)
    scan = scan_source(recipe.dataset, recipe.parts.fields, source)

    def run(cache: Cache) -> Plan:
        ready = replace(recipe, fields=tuple(_resolved(cache, field) for field in recipe.fields))
        parts = ready.parts
        groups = source_groups(ready, parts, scan)
        sources = sources_of(cache, ready, scan, jobs=jobs, progress=reporter, hash_music=_length, hash_rows=_rows_id)
        takes, unusable = takes_of(cache, ready.dataset, sources, jobs=jobs, progress=reporter)
        results = cut_windows(expand(takes, parts.transforms), parts.fields, parts.windows)
        results = whole(_examined(cache, results, jobs, reporter), groups)
        rejects = (*sources.rejects, *unusable, *(reject for result in results for reject in result.rejects))
        kept = [result for result in results if result.starts]
        cached = {field.name: _count_cached(cache, field, kept) for field in parts.fields}
        flags = [
            {"clip": result.take.dancers[k].id, **flag}
            for result in kept
            if result.take.parent is None
            for k in result.stay
            for flag in result.made[VITALS][k][1:]
            if flag["kind"] in IMPLAUSIBLE
        ]
        return Plan(recipe, source, sources.scan, tuple(kept), rejects, cached, tuple(flags))

    return build_cache.retry_lost(run, reporter)


def _examined(cache: Cache, results: Sequence[Result], jobs: int, progress: Progress) -> list[Result]:
    """Return results with the flags of motion; without takes that cannot be loaded, nor their copies."""
    origins = [result for result in results if result.take.parent is None]
    done = {r.take.id: r for r in compute(cache, origins, [Vitals()], jobs=jobs, progress=progress)}
    return [done.get(r.take.id, r if done[r.take.origin.id].starts else r.left_out(())) for r in results]


def _count_cached(cache: Cache, field: Field, results: Sequence[Result]) -> Cached:
    """Return how many results of a field are in the cache, and how many a build needs."""
    keys = {ask.key for result in results for ask in field.asks(result.take)}
    suffixes = ("npy", "json") if field.optional else ("npy",)  # an optional field that has no rows says why
    held = sum(any(cache.contains(field.stage, key, suffix) for suffix in suffixes) for key in keys)
    return Cached(field.unit, held, len(keys))


def _length(cache: Cache, path: Path) -> SignalId | Reject:
    """Return the signal of a song; one that no build has decoded by its header, its path in place of a hash."""
    from dancedata.music.signal import audio_length

    identified = SignalId.cached(cache, path)
    if identified is not None:
        return identified
    length = reject_on_error(lambda: audio_length(path), path)
    return length if isinstance(length, Reject) else SignalId(path, "", str(path), length[1], length[0])


def _rows_id(cache: Cache, path: Path) -> str:
    """Return the hash of a file of rows; of one that no build has read its path."""
    return cache.cached_sha256(path) or str(path)


def _resolved(cache: Cache, field: Field) -> Field:
    """Return a field as a build computes it; as it is, if that depends on weights that were not read before."""
    # ImportError: a login node that plans, without the packages that compute.
    with suppress(_UnknownError, UsageError, SourceError, ImportError):
        return field.resolved(_cached_sha256(cache))
    return field


def _not_ready(field: Field) -> str:
    """Return the error of a build with this field on this machine, such as missing weights; "" without one."""

    def unread(path: Path) -> str:
        path.stat()
        raise _UnknownError  # there are weights: a build reads them, a plan does not

    try:
        field.resolved(unread)
    except (UsageError, SourceError, OSError) as error:
        return str(error)
    except (_UnknownError, ImportError):
        pass
    return ""


class _UnknownError(Exception):
    pass


def _cached_sha256(cache: Cache) -> Callable[[Path], str]:
    def sha256(path: Path) -> str:
        sha256 = cache.cached_sha256(path)
        if sha256 is None:
            raise _UnknownError
        return sha256

    return sha256
