"""Cache keys of the motion of clips: everything that shapes the encoded rows."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.bodies import CROSSING, SKELETONS, crosses
from dancedata.core.clip import ClipRef
from dancedata.core.plugins import Dataset
from dancedata.core.quality import MAX_ROOT_SPEED_M_S, MAX_TURN_DEG_S, PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.curation.repair import VERSION as REPAIR_VERSION
from dancedata.execution.arithmetic import expected
from dancedata.execution.cache import Cache, package_version
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.documents import document_of
from dancedata.recipes.fields import KeyMotionField, MotionField
from dancedata.recipes.recipe import Recipe

#: Raised by hand when a stage gives other numbers for the same input.
MOTION_STAGE = 5


@dataclass(frozen=True)
class ClipKeys:
    """Cache keys of a clip.

    `info`: Key of the facts about it.
    `fields`: Keys of its motion and key motion fields, by name.
    `content`: Hashes of further files that shaped the keys, see `content_hashes`.
    """

    info: str
    fields: dict[str, str]
    content: dict[str, str]


class MotionKeys:
    """The cache keys of clips, or of `copies` of them with another motion. Their common part is hashed once.

    `content` are the hashes of further files, see `content_hashes`.
    """

    def __init__(self, recipe: Recipe, content: Mapping[str, str], copies: CopySpec | None = None) -> None:
        dataset = recipe.dataset
        loading = [dataset.name, dataset.version, document_of(dataset, loading=True), dict(content)]
        loading += [] if copies is None else [copies.key()]
        self._retarget, self._repairs = recipe.retarget, recipe.curation.repairs
        limits = [MAX_TURN_DEG_S, MAX_ROOT_SPEED_M_S, *PLAUSIBLE_BODY_M, *PLAUSIBLE_ROOT]
        self._content = dict(content)
        arithmetic = expected()
        self._clip = Cache.key("clip", version=MOTION_STAGE, dataset=loading, limits=limits, arithmetic=arithmetic)
        self._fields = {
            field.name: Cache.key(
                "motion",
                version=[MOTION_STAGE, *field.version],
                dataset=loading,
                # With `optional`: of an optional field an entry may have no rows, which others must not find.
                representation={field.name: field.document()},
                fps=str(field.grid),
                windows=_window_cut(recipe) if recipe.scope == "window" else None,
                packages={name: package_version(name) for name in ("numpy", "scipy")},
                arithmetic=arithmetic,
            )
            for field in recipe.clip_fields
        }
        self._recipe = recipe

    def of(self, ref: ClipRef, sha256: str, group: Sequence[tuple[ClipRef, str]] = ()) -> ClipKeys:
        """Return the keys of a clip, by its id (the parts of FineDance's 004 have one file) and its file's hash.

        `group` are all dancers of its group, whose length, floor and place shape its rows, with their files' hashes.
        """
        stage: dict[str, Any] = {}
        if group:
            stage["group"] = [[*clip_identity(other), of_file] for other, of_file in group]
        body = self._recipe.dataset.body_of(ref)
        if self._retarget is not None:
            stage["retarget"] = self._retarget.key(grouped=bool(ref.group))
            body = SKELETONS[self._retarget.skeleton]

        def key(common: str, *, repaired: bool, **crossing: int) -> str:
            repairs = {"repair": [REPAIR_VERSION, self._repairs.key()]} if repaired and self._repairs else {}
            identity = clip_identity(ref)
            return Cache.key("clip", common=common, clip=identity, file=sha256, **stage, **repairs, **crossing)

        unrepaired = {field.name for field in self._recipe.motion if not field.repaired}
        crossing = {clip_field.name for clip_field in self._recipe.clip_fields if _crosses(clip_field, body)}
        fields = {
            name: key(common, repaired=name not in unrepaired, **({"crossing": CROSSING} if name in crossing else {}))
            for name, common in self._fields.items()
        }
        return ClipKeys(key(self._clip, repaired=True), fields, self._content)


def clip_identity(ref: ClipRef) -> list[Any]:
    """Return all of a clip that `load` reads, except its file."""
    return [ref.id, ref.declared, str(ref.source_start), str(ref.source_end), ref.revision]


def content_hashes(dataset: Dataset, hash_file: Callable[[Path], str]) -> dict[str, str]:
    """Return the hashes of the files that a dataset's parameters name, such as a body model.

    These are the fields with the metadata ``{"content": True}``; of a folder all files. `hash_file` returns the
    SHA-256 of a file, such as `Cache.file_sha256`.
    """
    hashes: dict[str, str] = {}
    for f in dataclasses.fields(dataset):
        path = getattr(dataset, f.name)
        if f.metadata.get("content") and path is not None:
            root = Path(path).expanduser()
            files = sorted(p for p in root.rglob("*") if p.is_file()) if root.is_dir() else [root]
            for file in files:
                if file.exists():
                    named = file.relative_to(root if root.is_dir() else root.parent).as_posix()
                    hashes[f"{f.name}/{named}"] = hash_file(file)
    return hashes


def _crosses(clip_field: MotionField | KeyMotionField, body: Skeleton | None) -> bool:
    """Return whether columns depend on moving the clip to another body: cf. `core.bodies.on_body`."""
    if not isinstance(clip_field, MotionField) or clip_field.representation.positions_only:
        return False
    representation = clip_field.representation
    if body is not None and body.joints == SMPL24.joints and representation.grounded:
        return False  # its translation keeps its numbers
    return crosses(body, representation.skeleton)


def _window_cut(recipe: Recipe) -> list[Any]:
    # The fields together determine the number of windows, see usable_frames.
    rates = sorted({str(motion_field.grid) for motion_field in recipe.motion})
    return [recipe.windows.length, recipe.windows.stride, str(recipe.grid), rates]
