"""Results of takes: from the cache, or made by workers, each source loaded once for all that is made of it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dancedata.building.plugins import Ask, Loadable, Maker
from dancedata.building.result import Nothing, Result, Rows
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, UsageError, error_note
from dancedata.core.rejects import reject_of
from dancedata.execution.cache import DURABLE_FROM_S, Cache, CachedArray
from dancedata.execution.executors import Executor
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units

#: Parts of one source and maker in a unit of work: enough for what neighbours share to pay, few enough to share out
#: a long song among workers.
_PARTS = 128


class Unit(NamedTuple):
    """A unit of work: a source, and the `number`-th share of what is made of it."""

    source: Loadable
    wanted: Sequence[tuple[Maker, Sequence[Ask]]]
    number: int = 0

    @property
    def path(self) -> Path:
        """A file of the source, for messages."""
        return self.source.path


def compute(
    cache: Cache, results: Sequence[Result], makers: Sequence[Maker], *, jobs: Jobs, progress: Progress
) -> list[Result]:
    """Return results with what all makers make of takes that have windows, without dancers for whom one fails."""
    asks = {(maker.id, r.take.id): maker.asks(r.take) for maker in makers for r in results if r.starts}
    by_key: dict[str, Any] = {}
    for lane in dict.fromkeys(maker.lane for maker in makers):
        of_lane = [maker for maker in makers if maker.lane == lane]
        label = of_lane[0].lane or "computing"
        by_key |= _run_all(cache, list(units_of(of_lane, asks.items())), jobs=jobs, label=label, progress=progress)
    return [_with_made(result, makers, asks, by_key) for result in results]


def make_all(cache: Cache, maker: Maker, asks: Sequence[Ask], *, jobs: Jobs, progress: Progress) -> dict[str, Any]:
    """Return what one maker makes by key; a Reject of each that cannot be made."""
    units = list(units_of([maker], [((maker.id, ""), asks)]))
    return _run_all(cache, units, jobs=jobs, label=maker.id, progress=progress)


def make(cache: Cache, unit: Unit) -> dict[str, Any]:
    """Load a source, make what is missing of it, and publish it; return all results by key."""
    source, wanted = unit.source, unit.wanted
    with cache.lock("units", Cache.key("unit", source=source.key, lane=wanted[0][0].lane, number=unit.number)):
        by_key = {ask.key: _look_up(cache, maker, ask.key) for maker, asks in wanted for ask in asks}
        missing = [(maker, [ask for ask in asks if by_key[ask.key] is None]) for maker, asks in wanted]
        if not any(asks for _, asks in missing):
            return by_key
        try:
            loaded = source.load()
        except DataError as error:
            reject = reject_of(error, file=source.path)
            return {key: reject if cached is None else cached for key, cached in by_key.items()}
        for within in dict.fromkeys(ask.within for _, asks in missing for ask in asks):
            for maker, asks in missing:
                of_scene = [ask for ask in asks if ask.within == within]
                for begin in range(0, len(of_scene), maker.batch):
                    by_key |= _make_batch(cache, source, maker, loaded, of_scene[begin : begin + maker.batch])
    return by_key


def units_of(makers: Sequence[Maker], asks: Iterable[tuple[tuple[str, Any], Sequence[Ask]]]) -> Iterator[Unit]:
    """Yield each source with what is made of it, many parts shared out; `asks` are by the maker's id and more."""
    by_id = {maker.id: maker for maker in makers}
    by_source: dict[str, tuple[Loadable, dict[str, dict[str, Ask]]]] = {}
    for (maker_id, _), of_maker in asks:
        for ask in of_maker if maker_id in by_id else ():
            _, of_source = by_source.setdefault(ask.source.key, (ask.source, {}))
            of_source.setdefault(maker_id, {})[ask.key] = ask
    for source, of_source in by_source.values():
        of_makers = [(by_id[maker_id], list(of.values())) for maker_id, of in of_source.items()]
        for number, begin in enumerate(range(0, max(len(of) for _, of in of_makers), _PARTS)):
            cut = [(maker, of[begin : begin + _PARTS]) for maker, of in of_makers]
            yield Unit(source, [(maker, of) for maker, of in cut if of], number)


def cached_results(cache: Cache, unit: Unit) -> dict[str, Any] | None:
    """Return all that is made of a source by key; None if a part is missing."""
    by_key = {}
    for maker, asks in unit.wanted:
        for ask in asks:
            by_key[ask.key] = _look_up(cache, maker, ask.key)
            if by_key[ask.key] is None:
                return None
    return by_key


def _run_all(cache: Cache, units: Sequence[Unit], *, jobs: Jobs, label: str, progress: Progress) -> dict[str, Any]:
    """Return the results of units of one lane by key; a Reject of each that cannot be made."""
    if not units:
        return {}
    cached, maker = [cached_results(cache, unit) for unit in units], units[0].wanted[0][0]
    calls = [(cache, unit) for unit in units]
    if None in cached:  # devices are looked up only if there is something to compute
        jobs = replace(jobs, n=maker.workers(jobs.n)) if isinstance(jobs, Executor) else maker.workers(jobs)
    of_units = run_units(make, calls, cached=cached, jobs=jobs, label=label, progress=progress, exact=not maker.lane)
    return {key: result for of_unit in of_units for key, result in of_unit.items()}


def _with_made(
    result: Result,
    makers: Sequence[Maker],
    asks: Mapping[tuple[str, tuple[str, str]], Sequence[Ask]],
    by_key: Mapping[str, Any],
) -> Result:
    """Return a result with what was made of its take, without the dancers whose results are rejects."""
    of_take: dict[str, list[Any]] = {}
    for maker in makers if result.starts else ():
        pairs = [(ask, by_key[ask.key]) for ask in asks[maker.id, result.take.id]]
        rows = [Rows(x, ask.key, ask.offset) if isinstance(x, CachedArray) else x for ask, x in pairs]
        of_take[maker.id] = rows or [()] * len(result.take.dancers)
    lost = {k: [of[k] for of in of_take.values() if isinstance(of[k], Reject)] for k in result.stay}
    return replace(result, made=of_take).without(lost)


def _make_batch(cache: Cache, source: Loadable, maker: Maker, loaded: Any, asks: Sequence[Ask]) -> dict[str, Any]:
    """Make results of one maker and scene and publish them; a Reject of each that cannot be made."""
    started = time.monotonic()
    try:
        with error_note(f"dancedata: while {maker.id} was made of {source.path}"):
            results = maker.make(loaded, [ask.part for ask in asks])
        source.check(cache)
    except DataError as error:
        return {ask.key: reject_of(error, file=source.path) for ask in asks}
    except UsageError as error:  # ends the build
        error.where = error.where or source.path
        raise
    durable = time.monotonic() - started > DURABLE_FROM_S * len(asks)
    by_key = {ask.key: result for ask, result in zip(asks, results, strict=True)}
    for key, result in by_key.items():
        if isinstance(result, Nothing) or maker.suffix == "json":
            cache.put_json(maker.stage, key, result)
        else:
            by_key[key] = cache.put_array(maker.stage, key, np.asarray(result), durable=durable)
    return by_key


def _look_up(cache: Cache, maker: Maker, key: str) -> Any:
    """Return a result of a maker from the cache; None without one."""
    if maker.suffix == "json":
        return cache.json(maker.stage, key)
    array = cache.array(maker.stage, key)
    if array is not None:
        return array
    reason = cache.json(maker.stage, key)
    return None if reason is None else Nothing(*reason)
