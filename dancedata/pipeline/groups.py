"""Groups of dancers in a build: one time, one world, and a group is stored whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TypeVar

import numpy as np

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.spatial import middle_of
from dancedata.core.text import listed
from dancedata.pipeline.rejects import attempt
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.recipe import Recipe

T = TypeVar("T")
#: Dancers of a group are cut to the shortest, if none is longer by more than this.
TOLERANCE_S = Fraction(1, 4)


def groups_of(clips: Sequence[T], ref_of: Callable[[T], ClipRef]) -> dict[str, list[T]]:
    """Return the dancers of each group, by member; single dancers are left out."""
    groups: dict[str, list[T]] = {}
    for clip in clips:
        if ref_of(clip).group:
            groups.setdefault(ref_of(clip).group, []).append(clip)
    return {name: sorted(members, key=lambda clip: ref_of(clip).member) for name, members in groups.items()}


def members_of(refs: Sequence[ClipRef]) -> dict[str, tuple[str, ...]]:
    """Return the ids of each group's dancers, as the source has them."""
    return {name: tuple(ref.id for ref in members) for name, members in groups_of(refs, lambda ref: ref).items()}


def sizes_of(refs: Sequence[ClipRef]) -> dict[str, int]:
    """Return the number of each group's dancers in the source."""
    groups = groups_of(refs, lambda ref: ref).items()
    return {name: max(len(members), *(ref.group_size for ref in members)) for name, members in groups}


def whole_groups(
    recipe: Recipe, clips: Sequence[T], scanned: Sequence[ClipRef], ref_of: Callable[[T], ClipRef]
) -> tuple[list[T], list[Reject]]:
    """Set groups aside that lack a dancer, unless the recipe keeps the others; `scanned` are those of the source."""
    present, sizes = {ref_of(clip).id for clip in clips}, sizes_of(scanned)
    lacking = {}
    for group, ids in members_of(scanned).items():
        unlisted = sizes[group] - len(ids)
        without = [clip for clip in ids if clip not in present]
        if without or unlisted:
            lacking[group] = [*without, *([f"{unlisted} that the source lacks"] if unlisted else [])]
    if recipe.incomplete_groups == "keep" or not lacking:
        return list(clips), []
    kept, rejects = [], []
    for clip in clips:
        ref = ref_of(clip)
        if ref.group not in lacking:
            kept.append(clip)
            continue
        detail = f"group {ref.group} is incomplete without {listed(lacking[ref.group])}"
        fix = "mend the dancers that were left out, or store the others: --set groups.incomplete=keep"
        rejects.append(Reject("incomplete_group", ref.id, str(ref.motion_path), detail=detail, fix=fix))
    return kept, rejects


def require_places(recipe: Recipe) -> None:
    """Raise UsageError for fields that cannot hold a group: dancers anywhere would have equal columns."""
    beside = {field.grid for field in recipe.motion if field.representation.name == "root_place"}
    for field in recipe.motion:
        spatial = field.representation.spatial
        if spatial is not None and spatial.placeless and field.grid not in beside:
            raise UsageError(
                f"the representation {field.representation.name} cannot hold groups: its columns have no places",
                where=f"motion.{field.name}",
                found=f"groups in the source of {recipe.dataset.name}",
                fix=f"store the places beside it, motion: {{root_place: {{fps: {field.grid}}}}}, or choose a "
                "representation that has them, such as edge151",
            )
    if recipe.retarget is not None:
        raise UsageError(
            "groups cannot be retargeted: each dancer is lifted onto the floor by a height of his own",
            where="retarget",
            found=f"groups in the source of {recipe.dataset.name}",
            fix="leave out retarget, and choose a representation that the dancers' own skeleton fits",
        )
    if recipe.curation.repairs.floor is not None:
        raise UsageError("the floor of groups cannot be repaired: each dancer would get a floor of his own",
                         where="repair.floor", found=f"groups in the source of {recipe.dataset.name}",
                         fix="leave out repair.floor")  # fmt: skip
    if recipe.scope == "window":
        raise UsageError("groups are stored whole", found="scope: window", fix="build with scope: track")


def group_motions(
    recipe: Recipe, refs: Sequence[ClipRef], copies: CopySpec | None = None, *, repaired: bool = True
) -> list[Motion]:
    """Load the dancers of a group, cut to one length, with one trim_start; or their copies, changed as one world.

    Each is repaired as the recipe asks for, or is as it was.

    DataError for other rates, and for lengths that differ by more than `TOLERANCE_S`.
    """
    motions = recipe.dataset.load_group(refs)
    where = f"group {refs[0].group}"
    rates = sorted({str(motion.grid) for motion in motions})
    if len(rates) > 1:
        raise DataError("the dancers of a group differ in their rate", reason="other_rate", where=where, found=rates)
    lengths = [motion.n_frames for motion in motions]
    grid = motions[0].grid
    if grid.seconds(max(lengths) - min(lengths)) > TOLERANCE_S:
        raise DataError("the dancers of a group differ in length", reason="length_mismatch", where=where,
                        found=", ".join(f"{ref.id} {n} frames" for ref, n in zip(refs, lengths, strict=True)),
                        allowed=f"at most {float(TOLERANCE_S):g} s of difference")  # fmt: skip
    trim = max(motion.trim_start for motion in motions)
    motions = [replace(motion.part(0, min(lengths)), trim_start=min(trim, min(lengths) - 1)) for motion in motions]
    motions = [recipe.curation.repairs.apply(motion).motion for motion in motions] if repaired else motions
    return motions if copies is None else _copied(motions, refs, copies)


def unusable_dancers(recipe: Recipe, refs: Sequence[ClipRef]) -> dict[int, Reject]:
    """Load the dancers of a group one by one, and return the rejects of those that cannot be, by their places."""
    loaded = [attempt(partial(recipe.dataset.load, ref), ref.motion_path, ref.id) for ref in refs]
    return {k: result for k, result in enumerate(loaded) if isinstance(result, Reject)}


def require_acts_on(copies: CopySpec) -> None:
    """Raise UsageError for an augmentation that does not say what it changes in a group."""
    if copies.augmentation.acts_on is None:
        raise UsageError(
            f"the augmentation {copies.name} does not say what it does to a group",
            fix='set `acts_on` in its class: "world" for one change of all dancers, "body" for one of each',
        )


def _copied(motions: Sequence[Motion], refs: Sequence[ClipRef], copies: CopySpec) -> list[Motion]:
    require_acts_on(copies)
    acts_on = copies.augmentation.acts_on
    if acts_on == "body":
        return [copies.motion_of(motion, ref.id) for motion, ref in zip(motions, refs, strict=True)]
    pelves = np.stack([motion.part(0, 1).joints()[0, 0] for motion in motions])
    middle = middle_of(pelves)
    # As a translation of each dancer: without the place of his pelvis at rest.
    axes = [middle - (pelvis - motion.translation[0]) for pelvis, motion in zip(pelves, motions, strict=True)]
    return [copies.motion_of(motion, refs[0].group, axis) for motion, axis in zip(motions, axes, strict=True)]
