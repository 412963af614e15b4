"""The groups of a report: their sizes, distances, facing, contacts and collisions, and what stands out of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from dancedata.core.grid import FrameGrid
from dancedata.core.text import counted, listed
from dancedata.kernel import Clip, Store
from dancedata.pages.bin_counts import BinCounts, FrameHistogram
from dancedata.scene.figure import Figure
from dancedata.scene.group_scene import GroupScene
from dancedata.scene.pieces import Piece

#: Two dancers look at each other where both face the other within this angle, degrees.
FACING_DEG = 45
#: Roots nearer than this are those of one dancer tracked twice, or of two in one place; farther ones of two places or
#: of wrong units. Metres.
NEAR_M, FAR_M = 0.1, 30.0
#: Share of frames with intersecting bodies above which a group is named.
COLLIDING = 0.05


@dataclass(frozen=True)
class GroupRow:
    """A group that is not a copy; None where nothing was measured."""

    group: str
    split: str
    # `clips`, `members`, `roles`: of its dancers; the source has `n_source`
    clips: tuple[str, ...]
    members: tuple[int, ...]
    roles: tuple[str, ...]
    n_source: int
    frames: int
    windows: int
    # `distance_min_m`, `distance_p50_m`, `distance_max_m`: distances of two roots, over pairs and frames
    distance_min_m: float | None = None
    distance_p50_m: float | None = None
    distance_max_m: float | None = None
    nearest: tuple[str, ...] = ()  # clips of the two with the least distance
    facing_share: float | None = None  # share of frames in which two dancers look at each other, over pairs
    # `contacts`, `contact_share`: stretches of a hand near another dancer, and the share of frames with one
    contacts: int | None = None
    contact_share: float | None = None
    collision_share: float | None = None  # share of frames in which two bodies intersect
    # intersecting pairs per frame, each in both orders (TIF of `intersection_frequency`)
    intersections: float | None = None
    colliding: tuple[str, ...] = ()  # clips of the two that intersect in most frames; empty without


@dataclass
class MeasuredGroups:
    """Groups that were measured, and counts over pairs and frames."""

    rows: list[GroupRow] = field(default_factory=list)
    distance: BinCounts = field(default_factory=lambda: BinCounts.of(0, 40, 0.01))  # of two roots, metres
    # angles between where a dancer faces and another, degrees
    facing: BinCounts = field(default_factory=lambda: BinCounts.of(0, 180, 1))

    def add(self, store: Store, dancers: Sequence[Clip], pieces: Sequence[Piece], windows: int) -> None:
        """Measure a group; there are no pieces where a dancer lacks the field."""
        first = dancers[0]
        sizes = store.group_sizes
        row = GroupRow(
            first.group, first.split, tuple(c.id for c in dancers), tuple(c.member for c in dancers),
            tuple(c.role for c in dancers), sizes.get(first.group, len(dancers)), first.n_frames, windows,
        )  # fmt: skip
        figures = [trimmed(piece, store.grid, first.trim_start) for piece in pieces]
        together = GroupScene.of(figures) if figures and figures[0].n_frames else None
        if together is not None and together.pairs:
            for pair in together.pairs:
                self.distance.add(pair.distance_m)
                self.facing.add(pair.facing_deg[np.isfinite(pair.facing_deg)])
            row = _with_pairs(row, together)
        self.rows.append(row)


def trimmed(piece: Piece, grid: FrameGrid, trim_start: int) -> Figure:
    """Return joints and contacts from a frame on, counted on the grid of the dataset."""
    figure = piece.figure
    first = max(0, grid.rows_up(trim_start, of=figure.grid))
    return replace(figure, joints=figure.joints[first:], contacts=figure.contacts[first:])


def _with_pairs(row: GroupRow, together: GroupScene) -> GroupRow:
    """Return the row of a group with the numbers of its pairs; arrays (pairs, frames)."""
    pairs = together.pairs
    distance = np.stack([p.distance_m for p in pairs])
    facing = np.stack([p.facing_deg for p in pairs])
    collides = np.stack([p.collides for p in pairs])
    touches = _touches(together)
    names = [(row.clips[p.first], row.clips[p.second]) for p in pairs]
    upright = np.asarray(np.isfinite(facing).all(axis=1))
    looks = np.asarray((facing <= FACING_DEG).all(axis=1))
    row = replace(
        row,
        distance_min_m=float(distance.min()),
        distance_p50_m=float(np.median(distance)),
        distance_max_m=float(distance.max()),
        nearest=names[int(distance.min(axis=1).argmin())],
        facing_share=float(looks[upright].mean()) if upright.any() else None,
    )
    if not together.touch:
        return row
    return replace(
        row,
        contacts=sum(len(pair.contacts) for pair in pairs),
        contact_share=float(touches.mean()),
        collision_share=float(collides.any(axis=0).mean()),
        intersections=float(2 * collides.sum(axis=0).mean()),
        colliding=names[int(collides.sum(axis=1).argmax())] if collides.any() else (),
    )


def _touches(together: GroupScene) -> npt.NDArray[np.bool_]:
    """Return the frames (T,) in which any two dancers touch."""
    touches = np.zeros(len(together.pairs[0].distance_m), dtype=np.bool_)
    for pair in together.pairs:
        for contact in pair.contacts:
            touches[contact.start : contact.end] = True
    return touches


@dataclass(frozen=True)
class Groups:
    """The groups of a dataset, without copies; empty in a dataset of single dancers."""

    by_size: Mapping[str, Mapping[str, int]]  # groups by number of dancers, then by split
    # `dancer_hours`, `group_hours`: lengths of the clips of groups, and of the groups
    dancer_hours: float
    group_hours: float
    # `distance_m`, `facing_deg`: distances of two roots; angles between where a dancer faces and another: over pairs
    # and frames
    distance_m: FrameHistogram
    facing_deg: FrameHistogram
    groups: tuple[GroupRow, ...]


def groups_of(
    store: Store, measured: MeasuredGroups, distance_m: tuple[float, ...], facing_deg: tuple[float, ...]
) -> Groups:
    """Return the groups of a dataset; the last two are the borders of bins."""
    rows = measured.rows
    sizes = Counter((len(row.clips), row.split) for row in rows)
    seconds = [(len(row.clips), float(store.grid.seconds(row.frames))) for row in rows]
    return Groups(
        by_size={str(n): {s: sizes[n, s] for s in store.splits} for n in sorted({n for n, _ in sizes})},
        dancer_hours=sum(n * length for n, length in seconds) / 3600,
        group_hours=sum(length for _, length in seconds) / 3600,
        distance_m=FrameHistogram.of(measured.distance, distance_m),
        facing_deg=FrameHistogram.of(measured.facing, facing_deg),
        groups=tuple(rows),
    )


def group_findings(groups: Groups) -> list[tuple[str, str]]:
    """Return sentences on groups, each with its kind: "look" or "note"."""
    rows, findings = groups.groups, []
    colliding = sorted(
        (row for row in rows if (row.collision_share or 0) > COLLIDING), key=lambda r: -(r.collision_share or 0)
    )
    if colliding:
        names = [f"{r.group} in {100 * (r.collision_share or 0):.0f} % of its frames" for r in colliding]
        text = f"bodies intersect in {len(colliding):,} of {counted(len(rows), 'group')}: {listed(names, 3)}"
        findings.append(("look", text))
    near = [r.group for r in rows if r.distance_min_m is not None and r.distance_min_m < NEAR_M]
    if near:
        apart = f"less than {100 * NEAR_M:.0f} cm apart"
        text = f"two dancers are in one place, {apart}, in {counted(len(near), 'group')}"
        findings.append(("look", f"{text}: {listed(near, 4)}"))
    far = [r.group for r in rows if r.distance_max_m is not None and r.distance_max_m > FAR_M]
    if far:
        text = f"dancers are more than {FAR_M:.0f} m apart in {counted(len(far), 'group')}"
        findings.append(("look", f"{text}: {listed(far, 4)}"))
    lacking = [f"{r.group} ({len(r.clips)} of {r.n_source})" for r in rows if len(r.clips) < r.n_source]
    if lacking:
        findings.append(("note", f"{counted(len(lacking), 'group')} without all dancers: {listed(lacking, 4)}"))
    return findings
