"""Selects windows of a store by split, lists, trim, length and a filter, and reports the ones left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import FILTERS
from dancedata.core.text import counted
from dancedata.store import ClipRecord
from dancedata.store.clip_choice import clips_with
from dancedata.store.dataset import Store
from dancedata.store.window_list import WindowList
from dancedata.torch.clip_values import ASKED, chosen_clips
from dancedata.torch.music_beats import StartAt
from dancedata.torch.options import FilterLike, Select

if TYPE_CHECKING:
    from dancedata.core.plugins import WindowFilter

#: The fix for music without downbeats.
_NO_DOWNBEATS = (
    "beats by librosa have no downbeats: build with audio: {beats: {source: beat_this}}, or give "
    "Windows(start_at='beat'), or use shorter windows"
)


@dataclass(frozen=True)
class WindowQuery:
    """Criteria for windows: those of `Windows` and `Select`, checked, and the fields that windows lie within."""

    fields: tuple[str, ...]
    windows: Mapping[str, Any] = field(default_factory=dict)
    trim: bool = False
    ignore: tuple[str, ...] = ()
    protocol: str | None = None
    filter: WindowFilter | None = None
    start_at: StartAt | None = None
    where: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class SelectedWindows:
    """Windows in the store's order, and the clips and windows that were left out."""

    windows: WindowList
    rejects: tuple[Reject, ...]


def select(store: Store, split: str, choice: WindowQuery) -> SelectedWindows:
    """Select the windows of a split; UsageError for an unknown split, or windows that the store cannot provide."""
    marked = [name.partition(":") for name in choice.ignore if ":" in name]
    choice = replace(choice, ignore=tuple(name for name in choice.ignore if ":" not in name))
    windows, rejects = _windows(store, split, choice)
    for layer, _, label in marked:
        unmarked, found = _unmarked(store, windows, layer, label)
        windows, rejects = windows.take(unmarked), rejects + found
    if choice.start_at is not None:
        from dancedata.torch.beat_starts import windows_at

        windows, beatless = windows_at(
            store, windows, choice.windows, at=choice.start_at, fields=choice.fields, trim=choice.trim
        )
        rejects += beatless
    if choice.filter is not None and split in choice.filter.splits:
        passing, filtered = _filtered(store, windows, choice.filter)
        windows, rejects = windows.take(passing), rejects + filtered
    return SelectedWindows(windows, tuple(rejects))


def _windows(store: Store, split: str, choice: WindowQuery) -> tuple[WindowList, list[Reject]]:
    """Return the windows of the clips of a split that are not ignored, and rejects of its other clips."""
    tables, rejects = store._tables, list[Reject]()
    members = chosen = _members(store, split, choice.protocol)
    # A protocol's split has clips of several stored splits.
    stored = [name for name in store.splits if (members & tables.in_split(name)).any()] or [split]
    parts = [store.windows(name, fields=choice.fields, trim=choice.trim, **choice.windows) for name in stored]
    windows = WindowList.joined(split, parts)
    if choice.ignore:
        lists = {*choice.ignore, f"ignored.{choice.protocol}"}
        ignored = members & clips_with(tables, "lists", tuple(lists))
        for row in np.flatnonzero(ignored).tolist():
            names = [name for name in tables.columns["lists"][row] if name in lists]
            rejects.append(Reject("ignored", tables.ids[row], detail=f"on the list {', '.join(names)}"))
        chosen = members & ~ignored
    listed = _listed(store, choice.protocol)
    if listed and split in store.splits:
        unlisted = tables.in_split(split) & ~clips_with(tables, "lists", listed)
        detail = f"on no list of {choice.protocol}"
        rejects += [Reject("unassigned", tables.ids[row], detail=detail) for row in np.flatnonzero(unlisted).tolist()]
    if choice.where:
        chosen, unlike = chosen_clips(tables, choice.where, chosen)
        rejects += unlike
    if chosen is not members or listed:
        windows = windows.take(chosen[windows.clip])
    missing = chosen & (np.bincount(windows.clip, minlength=tables.n_clips) == 0)
    short = sorted((tables.record(row) for row in np.flatnonzero(missing).tolist()), key=lambda clip: clip.id)
    return windows, rejects + [_without_window(store, clip, choice) for clip in short]


def _members(store: Store, split: str, protocol: str | None) -> npt.NDArray[np.bool_]:
    """Return which clips (N,) are of a split: those of the protocol's lists, if the store has such lists."""
    tables, listed, name = store._tables, _listed(store, protocol), f"{protocol}.{split}"
    if not listed:
        store._rows_of_split(split)  # an error for an unknown one
        return tables.in_split(split)
    if name not in listed:
        splits = sorted(each.removeprefix(f"{protocol}.") for each in listed)
        raise UsageError(f"no clip of the store is in {protocol}'s split {split!r}", where=str(store.path),
                         fix=did_you_mean(split, splits))  # fmt: skip
    members = clips_with(tables, "lists", (name,))
    if split != "train" and "source" in tables.columns:
        members &= tables.columns["source"].isin([""])  # copies are for training only, whatever split has them
    return members


def _listed(store: Store, protocol: str | None) -> tuple[str, ...]:
    return tuple(name for name in list_names(store) if protocol is not None and name.startswith(f"{protocol}."))


def _unmarked(
    store: Store, windows: WindowList, layer: str, label: str
) -> tuple[npt.NDArray[np.bool_], list[Reject]]:
    """Return which windows no segment with a label overlaps, (W,), and a reject for each of the others."""
    store._require_layer(layer)
    keep = np.ones(len(windows), dtype=np.bool_)
    rejects = []
    for place, window in enumerate(windows):
        if any(placed.segment.label == label for placed in store.segments(window, layer)):
            keep[place] = False
            rejects.append(Reject("ignored", window.clip, window=window.start, detail=f"{layer}: {label}"))
    return keep, rejects


def list_names(store: Store) -> set[str]:
    """Return the names of the lists that clips are in."""
    lists = store._tables.columns.get("lists")
    return set() if lists is None else lists.values.distinct()


def require_lists(store: Store, asked: Select) -> None:
    """Raise UsageError for lists and protocols that no clip is in: misspelt ones would leave out nothing."""
    lists = list_names(store)
    protocols = sorted({name.rpartition(".")[0] for name in lists} - {"", "ignored"})
    if asked.protocol is not None and asked.protocol not in protocols:
        known = did_you_mean(asked.protocol, protocols)
        raise UsageError(f"no clip is in a list of the protocol {asked.protocol!r}", where=str(store.path),
                         fix=known if protocols else "take the splits of the dataset: select=Select()")  # fmt: skip
    for name in asked.ignore:
        if ":" not in name and name not in lists and name.partition(".")[0] != "ignored":
            raise UsageError(f"ignore: no clip is in a list named {name!r}", where=str(store.path),
                             fix=did_you_mean(name, sorted(lists)))  # fmt: skip


def _without_window(store: Store, record: ClipRecord, choice: WindowQuery) -> Reject:
    absent = store._without(record.id, choice.fields)
    if absent:
        return Reject("no_field", record.id, detail=f"kept without {', '.join(absent)}")
    trimmed = f", {record.trim_start} of them trimmed" if choice.trim and record.trim_start else ""
    detail = f"{record.n_frames} frames{trimmed}: not long enough for a window of fields {', '.join(choice.fields)}"
    return Reject("too_short", record.id, detail=detail, numbers={"frames": record.n_frames})


def _filtered(store: Store, windows: WindowList, plugin: WindowFilter) -> tuple[npt.NDArray[np.bool_], list[Reject]]:
    filtered_field = store.field(plugin.field)
    plugin.check(filtered_field.columns)
    passes = np.ones(len(windows), dtype=np.bool_)
    rejects: list[Reject] = []
    for k, window in enumerate(windows):
        rows = store.read(window, plugin.field)
        rows.flags.writeable = False
        reject = plugin.reject(rows, filtered_field.columns, filtered_field.grid)
        if reject is not None:
            passes[k] = False
            rejects.append(replace(reject, clip=window.clip, window=window.start))
    return passes, rejects


def no_window_error(store: Store, split: str, rejects: Sequence[Reject], at: StartAt | None) -> UsageError:
    """Return the error of a split in which no window is left, where windows begin at `at`."""
    beatless = [r for r in rejects if at is not None and r.detail.startswith(f"no {at} at ")]
    if beatless:
        return UsageError(
            f"no window of split {split!r} can begin at a {at}",
            where=str(store.path),
            found=f"{counted(len(beatless), 'clip')}, the first is {beatless[0].clip}: {beatless[0].detail}",
            fix=_NO_DOWNBEATS if at == "downbeat" else "use shorter windows",
        )
    unlike = [r for r in rejects if r.detail.endswith(ASKED)]
    if unlike and len(unlike) == len(rejects):
        return UsageError(f"no clip of split {split!r} has the values that where= asks for", where=str(store.path),
                          found=f"{counted(len(unlike), 'clip')}, the first is {unlike[0].clip}: {unlike[0].detail}",
                          fix="store.to_pandas() has the values of all clips")  # fmt: skip
    longest = max((c.n_frames for c in store), default=0)
    reasons = ", ".join(sorted({r.reason for r in rejects})) or "nothing"
    return UsageError(f"split {split!r} has no windows of that length", where=str(store.path),
                      found=f"clips of at most {longest} frames at {store.fps} per second; left out: {reasons}",
                      fix="use shorter windows, or fewer lists and filters")  # fmt: skip


def window_filter(choice: FilterLike) -> WindowFilter | None:
    """Return a window filter from a plug-in, or from its name and parameters, as in a recipe."""
    if choice is None:
        return None
    if isinstance(choice, FILTERS.base):
        return choice
    if not isinstance(choice, Mapping) or len(choice) != 1:
        raise UsageError(
            "filter must name one window filter", found=choice, allowed='{"movement": {"min_std": 0.07}}'
        )
    ((name, parameters),) = choice.items()
    return FILTERS.make(name, parameters or {})
