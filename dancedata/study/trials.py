"""The trials of a study: which two dancers stand side by side, to which song, and which of them is left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations

import numpy as np

from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.sample_id import SampleId
from dancedata.core.text import counted, listed
from dancedata.scene.figure import Figure
from dancedata.scene.scene_list import Item, SceneList, begins_after

#: The dancer of a check who stands still.
STILL = "(stands still)"
#: Shortest clip of a trial, seconds.
LEAST_S = 2.0


@dataclass(frozen=True)
class Trial:
    """One question; in a check `left` or `right` is `STILL`, else they are names of systems."""

    number: int  # place in the study; raters see an order of their own
    song: str  # song of the clip; its id where no song is known
    clip: str  # id of the clip, or the song where the systems name their clips differently
    left: str
    right: str

    @property
    def is_check(self) -> bool:
        """Whether it shows that a rater looks: one of the two does not dance."""
        return STILL in (self.left, self.right)

    @property
    def expected(self) -> str:
        """The side that a rater who looks chooses in a check: "left" or "right"; "" for a pair."""
        return "" if not self.is_check else "right" if self.left == STILL else "left"


def common_clips(systems: Mapping[str, SceneList]) -> dict[str, dict[str, Item]]:
    """Return the item of each system by an id, clip or song that all have, preferably from the same second of it."""
    for name_of in (lambda item: item.id, clip_of, lambda item: item.clip.music):
        named: list[dict[str, list[Item]]] = []
        for scenes in systems.values():
            mine: dict[str, list[Item]] = {}
            for item in scenes.items:
                if (key := name_of(item)) and not _reason(item):
                    mine.setdefault(key, []).append(item)
            named.append(mine)
        shared = [name for name in named[0] if all(name in mine for mine in named[1:])]
        if shared:
            return {name: _nearest([mine[name] for mine in named], systems) for name in shared}
    examples = {system: listed([item.id for item in scenes.items], 2) for system, scenes in systems.items()}
    raise DataError(
        "the systems have no clip in common", reason="nothing_matched",
        found="; ".join(f"{name}: {text}{left_out(systems[name])}" for name, text in examples.items()),
        allowed="single dancers under the ids of the same clips or windows, or to the same songs",
        fix="write samples with save_samples; of a group name its dancers: GROUP~p0",
    )  # fmt: skip


def clip_of(item: Item) -> str:
    """Return the clip that an item is of; "" for a file of which it is unknown where in its song it begins."""
    if item.clip.split:
        return item.clip.id
    return SampleId.parse(item.clip.id).clip if item.clip.music else ""


def _reason(item: Item) -> str:
    """Return why an item is in no trial: a pair shows two dancers; a copy is shown where a sample is of it."""
    return "group" if item.members else "stored copy" if item.source and not item.sample else ""


def left_out(scenes: SceneList) -> str:
    """Return what of a system is in no trial, to append to a line; "" if nothing is."""
    reasons: dict[str, list[str]] = {}
    for item in scenes.items:
        if reason := _reason(item):
            reasons.setdefault(reason, []).append(item.id)
    return "".join(f", without {counted(len(ids), reason)}: {listed(ids, 2)}" for reason, ids in reasons.items())


def _nearest(named: Sequence[Sequence[Item]], systems: Mapping[str, SceneList]) -> dict[str, Item]:
    """Return an item of each system, so that they begin as near to each other in their song as there are any."""
    grids = [scenes.grid for scenes in systems.values()]

    def apart(one: Item, other: Item, grid: FrameGrid) -> Fraction:
        return abs(begins_after(other, grid, one, grids[0]))

    chosen = [
        [min(items, key=lambda item: apart(one, item, grid)) for items, grid in zip(named, grids, strict=True)]
        for one in named[0]
    ]
    best = min(chosen, key=lambda row: max(apart(row[0], item, grid) for item, grid in zip(row, grids, strict=True)))
    return dict(zip(systems, best, strict=True))


def make_trials(
    clips: Mapping[str, str], systems: Sequence[str], *, songs: int, checks: int, seed: int
) -> tuple[Trial, ...]:
    """Return the trials of a study: each pair of systems on each of the songs, and checks.

    `clips`: Song by the name of each clip that all systems have.
    `songs`: Number of clips; different songs come first.
    `checks`: Number of checks; in each the first system dances beside the same dancer who stands still.
    `seed`: Decides on clips and sides. Over a study every system is on the left as often as on the right, or once
        more.
    """
    if len(systems) < 2:
        raise UsageError("a study compares systems", found=listed(systems), allowed="two or more")
    if not 1 <= songs <= len(clips):
        raise UsageError("the systems have too few clips in common", found=f"{songs} asked for",
                         allowed=f"1 to {len(clips)}", fix="ask for fewer songs")  # fmt: skip
    if seed < 0:
        raise UsageError("invalid seed", found=seed, allowed="0 or more")
    if not 0 <= checks <= 100:
        raise UsageError("invalid number of checks", found=checks, allowed="0 to 100")
    rng = np.random.default_rng(seed)
    names = [list(clips)[k] for k in rng.permutation(len(clips))]
    seen: Counter[str] = Counter()
    turn = {}
    for name in names:
        turn[name] = seen[clips[name]]
        seen[clips[name]] += 1
    chosen = sorted(names, key=lambda name: turn[name])[:songs]  # a second clip of a song after the first of each
    rows: list[tuple[str, str, str]] = []
    for first, second in combinations(systems, 2):
        sides = np.arange(len(chosen)) % 2 == rng.integers(2)
        for name, swapped in zip(chosen, rng.permutation(sides), strict=True):
            rows.append((name, second, first) if swapped else (name, first, second))
    for k in range(checks):
        left, right = (systems[0], STILL) if (k + seed) % 2 else (STILL, systems[0])
        rows.append((chosen[k % len(chosen)], left, right))
    return tuple(Trial(number, clips[row[0]], *row) for number, row in enumerate(rows))


def shown_figures(
    trial: Trial, items: Mapping[str, Item], systems: Mapping[str, SceneList], seconds: float
) -> tuple[Figure, Figure]:
    """Return the two dancers of a trial at one rate, from `begin_of` on, as long as the shorter or `seconds`."""
    first = next(iter(systems))
    figures: dict[str, Figure] = {}
    for name in (trial.left, trial.right):
        if name == STILL:
            continue
        scene = systems[name].scene(items[name])
        if scene.figure is None:
            raise DataError(f"{name} cannot be drawn", reason="missing_joints", found="; ".join(scene.notes))
        figures[name] = scene.figure
    grid, begin = systems[first].grid, begin_of(items, systems)
    late = {n: float(begin - begins_after(items[n], systems[n].grid, items[first], grid)) for n in figures}
    length = min(seconds, *(f.n_frames / float(f.grid.rate) - late[n] for n, f in figures.items()))
    if length < LEAST_S and any(late.values()):
        begins = [f"{n} from its {float(systems[n].second(items[n])):g} s" for n in figures]
        raise UsageError("the dancers share too little of their song", reason="mixed_starts", where=trial.clip,
                         found=f"{', '.join(begins)}: {max(0.0, length):.2f} s in common",
                         allowed=f"{LEAST_S:g} s or more",
                         fix="name samples of the same windows, or watch them apart: dancedata view")  # fmt: skip
    if length < LEAST_S:
        raise DataError("the clip is too short for a trial", reason="too_short", where=trial.clip,
                        found=f"{length:.2f} s", allowed=f"{LEAST_S:g} s or more")  # fmt: skip
    grid = next(iter(figures.values())).grid
    cut = {name: figure.part(late[name], length).resampled(grid, length) for name, figure in figures.items()}
    if trial.is_check:
        dancing = next(iter(cut.values()))
        cut[STILL] = dancing.part(0, 1 / float(grid.rate)).resampled(grid, length)
    return cut[trial.left], cut[trial.right]


def begin_of(items: Mapping[str, Item], systems: Mapping[str, SceneList]) -> Fraction:
    """Return when a trial begins: seconds after the first system's clip does, when all dance to the same song."""
    first = next(iter(systems))
    grid = systems[first].grid
    return max(begins_after(items[name], scenes.grid, items[first], grid) for name, scenes in systems.items())
