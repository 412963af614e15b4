"""GroupDataset: windows of groups of dancers, all dancers of a window in one sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject, Window
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.placement import centroid, root_place
from dancedata.core.sample_id import safe_name
from dancedata.core.sample_steps import Augment
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.store.clip_columns import FREE
from dancedata.store.dataset import Store
from dancedata.store.motion_fields import sample_field
from dancedata.store.tables import Tables
from dancedata.store.window_list import IntArray, WindowList
from dancedata.torch.batch_reader import BatchPlan, BatchReader, FieldReader, MemoryPool, blank_of
from dancedata.torch.options import Dancers, Item, Scale, ScalerLike, Select, Windows, clash
from dancedata.torch.split_dataset import SplitDataset
from dancedata.torch.windows import WindowDataset

Array = npt.NDArray[Any]
#: Stream of random numbers that choose dancers; 1 to 5 are those of orders, mirroring, primitives and augmentations.
_CHOICE_STREAM = 6


class GroupDataset(WindowDataset):
    """Windows of groups of one split: the same frames of all dancers, each a dict of tensors and metadata.

    ``dataset[i]`` is ``{motion field: tensor (P, L, D), music and scene field: (L, D), "person_mask": bool (P,),
    "members": int (P,), the dancers' numbers in the source, -1 where nobody is, "group": id, "clips" and "roles":
    lists of P texts, "start", "length", "split", "genre", "music", ...}`` as in a `WindowDataset`. Rows of absent
    dancers are 0 after normalising, that is the scaler's middle; codes are the codebook's `pad`.

    What changes the world (mirror, yaw, root_offset) is one change for the group, about one axis; noise is drawn for
    each dancer. Nothing depends on the order of a group's members except bytes of "stored" and "seed".

    Parameters
    ----------
    store, split, fields, windows, scale, seed
        As in `WindowDataset`: ``"segments"`` and ``"text"`` are lists of P, and ``"segments_group"`` or
        ``"text_group"`` are those of the whole group; of free columns samples have lists of P values, None where
        there is none.
    dancers
        `Dancers`: how many, which, in which order, and whether single dancers are read.
    select
        Values that a group's first dancer has: ``Select(where=...)`` alone.
    augment
        As in `WindowDataset`; augmentations have to say what they act on (`Augmentation.acts_on`).

    Raises
    ------
    StoreError, UsageError
        Without a finished dataset; if no window is left, for an unknown choice, and for augmentations that do not say
        what they act on.

    Attributes
    ----------
    windows
        (N) the windows, each as that of the group's first dancer.
    rejects
        Single dancers, groups of another size and groups without a window, and why.

    Examples
    --------
    >>> from dancedata.torch import Dancers, GroupDataset
    >>> ds = GroupDataset("data/groups", "train", dancers=Dancers(persons=3))
    >>> ds[0]["edge151"].shape
    torch.Size([3, 150, 151])
    """

    _lists_columns = True

    def __init__(
        self,
        store: str | Path | Store,
        split: str = "train",
        fields: Sequence[Item] | None = None,
        *,
        dancers: Dancers = Dancers(),
        windows: Windows | None = None,
        select: Select | None = None,
        scale: Scale | ScalerLike | None = Scale(),
        augment: Augment = (),
        seed: int = 0,
    ) -> None:
        SplitDataset.__init__(self, store, split, fields, select, scale)
        self._items.require_plain("GroupDataset")
        if len(self.splits) > 1:
            raise UsageError("groups are read split by split", found=self.split, fix="join the readers of each split")
        cut, dancers = Windows.taken(windows), Dancers.taken(dancers)
        self.choose = dancers.choose
        if cut.start_at is not None or self._asked != Select(self._asked.where):
            asked = self._asked if cut.start_at is None else cut
            raise clash(asked, "GroupDataset", "groups are chosen by Select(where=...), at the stride, alone")
        chosen = self._choose(cut, cut.length_and_stride)
        self._group_windows(chosen.windows, dancers.exactly, dancers.singles, list(chosen.rejects))
        sizes = self._sizes[self._group_of]
        self.persons = dancers.persons or dancers.exactly or int(sizes.max(initial=1))
        self._prepare(augment, seed)
        self._check_augmentations()
        self._is_random |= self.choose == "seed"
        self._primitives, self._roots = None, {}
        self._stride = self.store._window_grid(**self._choice.windows).stride
        self._starts, self._cached_reader, self._pool = {}, None, MemoryPool()

    def _group_windows(self, dancers: WindowList, exactly: int | None, singles: bool, rejects: list[Reject]) -> None:
        """Reduce the windows of dancers to those of each group's first one; set windows, groups and rejects."""
        tables = self.store._tables
        chosen = tables.in_split(self.split)
        single = np.flatnonzero(chosen & (tables.group_of < 0))
        first, count = (np.asarray(tables.groups.get(n, ()), dtype=np.int64) for n in ("first", "count"))
        of_split = np.flatnonzero(chosen[first])
        n_groups = len(of_split)
        first = np.concatenate([first[of_split], single])
        count = np.concatenate([count[of_split], np.ones_like(single)])
        kept = np.ones(len(first), dtype=np.bool_)
        kept[n_groups:] = singles
        if exactly is not None:
            kept &= count == exactly
        if not singles and len(single):
            clips = f"{len(single)} single dancers, the first is {tables.ids[int(single[0])]}"
            rejects.append(Reject("single", detail=f"{clips}; Dancers(singles=True) reads them as groups of one"))
        lacking = self._without_field(tables, first[:n_groups], count[:n_groups])
        kept[list(lacking)] = False
        rejects += lacking.values()
        others = int((count[:n_groups] != exactly).sum()) if exactly is not None else 0
        if others:
            rejects.append(Reject("group_size", detail=f"{others} groups of another size than {exactly}"))
        group_of_first = np.full(tables.n_clips, -1, dtype=np.int64)
        group_of_first[first[kept]] = np.flatnonzero(kept)
        places = np.flatnonzero(group_of_first[dancers.clip] >= 0)
        if not len(places):
            raise UsageError(
                f"split {self.split!r} has no windows of groups",
                where=str(self.store.path),
                found=f"{n_groups} groups, {len(single)} single dancers; "
                + "; ".join(r.detail for r in rejects[-2:]),
                fix="give Dancers(singles=True), another exactly=, shorter windows, or read with WindowDataset",
            )
        self.windows, self.rejects = dancers.take(places), tuple(rejects)
        self._group_of, self._sizes = group_of_first[self.windows.clip], count
        sizes = count[self._group_of]
        self._begin = np.concatenate([[0], np.cumsum(sizes)])
        member = np.arange(self._begin[-1]) - np.repeat(self._begin[:-1], sizes)
        clip = np.repeat(self.windows.clip.astype(np.int64), sizes) + member
        start = np.repeat(self.windows.start.astype(np.int64), sizes)
        length = int(self.windows.length[0])
        self._dancers = WindowList.equally_long(self.split, self.windows.clip_ids, clip, start, length)

    def _without_field(
        self, tables: Tables, first: npt.NDArray[np.int64], count: npt.NDArray[np.int64]
    ) -> dict[int, Reject]:
        """Return a reject for each group with a dancer who does not have all fields, by the group's number."""
        rejects = {}
        for name in self.fields:
            having = tables.has_rows(self.store.field(name))
            for group in range(len(first)) if not having.all() else ():
                dancers = range(int(first[group]), int(first[group] + count[group]))
                absent = [tables.ids[row] for row in dancers if not having[row]]
                if absent:
                    detail = f"group {tables.record(dancers[0]).group}: {listed(absent, 3)} kept without {name}"
                    rejects[group] = Reject("no_field", detail=detail)
        return rejects

    def _check_augmentations(self) -> None:
        for step in self._augmenter.steps:
            if step.augmentation.acts_on is None:
                raise UsageError(
                    f"the augmentation {step.name} does not say what it does to a group",
                    fix='set `acts_on` in its class: "world" for one change of all dancers, "body" for one of each',
                )

    @override
    def _new_reader(self) -> BatchReader:
        return GroupReader(self)

    def dancers(self, place: int, epoch: int) -> npt.NDArray[np.int64]:
        """Return the places in their group of a window's dancers, in order; for "left_to_right" those of all."""
        n = int(self._sizes[self._group_of[place]])
        if self.choose == "seed":
            # n numbers, the same for any number of persons: with the places of the P least, dancers in drawn order.
            draw = Draw(self.seed, _CHOICE_STREAM, epoch, place)
            keys = [draw.uniform() for _ in range(n)]
            return np.argsort(keys, kind="stable")[: self.persons]
        return np.arange(n if self.choose == "left_to_right" else min(n, self.persons))

    @override
    def _metadata(
        self, plan: BatchPlan, windows: WindowList | None = None, changes: Sequence[str] = ()
    ) -> dict[str, list[Any]]:
        drawn = ("dancers",) if self.choose == "seed" else ()
        values = super()._metadata(plan, windows, (*drawn, *changes))
        tables = self.store._tables
        chosen = self._reader_of_groups().chosen(plan)
        first = self.windows.clip[np.asarray(plan.places, dtype=np.int64)].tolist()
        rows = [[row + member for member in members.tolist()] for row, members in zip(first, chosen, strict=True)]
        ids, roles = ([tables.values(name, of_sample) for of_sample in rows] for name in ("id", "role"))
        groups = [group or ids_of[0] for group, ids_of in zip(tables.values("group", first), ids, strict=True)]
        values["id"] = [
            name.replace(safe_name(clip), safe_name(group), 1)
            for name, clip, group in zip(values["id"], values["clip"], groups, strict=True)
        ]
        n_blank = [self.persons - len(of_sample) for of_sample in rows]
        del values["clip"], values["dancer"]
        if self._words is not None:
            read = [
                [Window(clip, start, length) for clip in clips]
                for clips, start, length in zip(ids, values["start"], values["length"], strict=True)
            ]
            values |= self._words.group_values(
                self.store, read, values["mirrored"], self.persons, plan.epoch, plan.places
            )
        free = [[tables.free(row) for row in of_sample] for of_sample in rows] if self.columns else []
        return values | {
            "group": groups,
            "clips": [clips + [""] * n for clips, n in zip(ids, n_blank, strict=True)],
            **{
                name: [
                    [of_clip.get(name.removeprefix(FREE)) for of_clip in clips] + [None] * n
                    for clips, n in zip(free, n_blank, strict=True)
                ]
                for name in self.columns
            },
            "roles": [of_sample + [""] * n for of_sample, n in zip(roles, n_blank, strict=True)],
        }

    @override
    def _segment_values(self, *of_windows: Any) -> dict[str, list[Any]]:
        return {}  # those of dancers, once they are chosen

    def _reader_of_groups(self) -> GroupReader:
        reader = self._batch_reader()
        assert isinstance(reader, GroupReader)  # noqa: S101 (made by this class alone)
        return reader

    @override
    def _samples_text(self) -> str:
        return f"{super()._samples_text()} of {self.persons} persons, {self.choose}"

    @override
    def _shape(self, name: str) -> tuple[int | str, ...]:
        people = (self.persons,) if self.store.field(name).per_clip else ()
        return *people, *super()._shape(name)


class GroupReader(BatchReader):
    """Reads batches of group windows: motion fields (B, P, L, D), shared ones (B, L, D), masks and members (B, P)."""

    def __init__(self, dataset: GroupDataset) -> None:
        self._dataset, store = dataset, dataset.store
        self._per_dancer = {name for name in dataset.fields if store.field(name).per_clip}
        fields = [
            dataset._field_reader(name, dataset._dancers if name in self._per_dancer else dataset.windows)
            for name in dataset.fields
        ]
        self._sample_fields = {name: sample_field(store, name) for name in self._per_dancer}
        super().__init__(store, fields, dataset._augmenter)

    @cached_property
    def layout(self) -> Mapping[str, tuple[tuple[int, ...], np.dtype[Any]]]:
        """Shape and type of every array of one sample, in a sample's order."""
        persons = (self._dataset.persons,)
        layouts: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        for field in self.fields:
            people = persons if field.name in self._per_dancer else ()
            layouts[field.name] = (*people, *field.rows.shape), field.dtype
        return {**layouts, "person_mask": (persons, np.dtype(np.bool_)), "members": (persons, np.dtype(np.int64))}

    @override
    def read(self, plan: BatchPlan, order: Sequence[int], out: Mapping[str, Array]) -> None:
        chosen = self.chosen(plan)
        for nth, members in enumerate(chosen):
            row = int(self._dataset.windows.clip[plan.places[nth]])
            out["person_mask"][nth] = np.arange(self._dataset.persons) < len(members)
            out["members"][nth] = -1
            out["members"][nth, : len(members)] = self._store._tables.values("member", (row + members).tolist())
        for field in self.fields:
            if field.name not in self._per_dancer:
                self.read_field(field, plan, order, out)
                continue
            target = out[field.name]
            for nth in order:
                rows = self._rows_of_group(field, plan, nth, chosen[nth])
                for person in range(len(rows)):
                    target[nth, person] = field.scale(rows[person])
                target[nth, len(rows) :] = blank_of(self._store, field.name)

    @override
    def require_unchanged(self, places: Sequence[int], *, again: bool = False) -> None:
        first = [int(self._dataset._begin[place]) for place in places]
        super().require_unchanged(first if self.fields[0].name in self._per_dancer else places, again=again)

    @override
    def read_ahead(self, places: Sequence[int]) -> None:
        begin = self._dataset._begin
        dancers = [k for place in places for k in range(int(begin[place]), int(begin[place + 1]))]
        for field in self.fields:
            field.rows.read_ahead(dancers if field.name in self._per_dancer else places)

    def chosen(self, plan: BatchPlan) -> list[IntArray]:
        """Return for each window of a plan the positions of its dancers in their group, in their order."""
        chosen = [self._dataset.dancers(place, plan.epoch) for place in plan.places]
        if self._dataset.choose != "left_to_right":
            return chosen
        return [self._left_to_right(plan, nth, members) for nth, members in enumerate(chosen)]

    def _left_to_right(self, plan: BatchPlan, nth: int, members: IntArray) -> IntArray:
        """Sort dancers by x in the first frame, then z, as they are given out."""
        for field in self.fields:
            if field.name in self._per_dancer:
                rows = self._rows_of_group(field, plan, nth, members)
                roots = self._roots(field.name, rows)
                if roots is not None:
                    across = roots.round(9)
                    return members[np.lexsort((members, across[:, 2], across[:, 0]))][: self._dataset.persons]
        raise UsageError("dancers cannot be sorted from left to right: no field has their places",
                         where=str(self._store.path), found=", ".join(sorted(self._per_dancer)),
                         fix='read a field with places, such as edge151, or Dancers(choose="stored")')  # fmt: skip

    def _rows_of_group(self, field: FieldReader, plan: BatchPlan, nth: int, members: IntArray) -> Array:
        """Read the rows of dancers, (P, L, D) of the stored type, mirrored and augmented as one world."""
        place = plan.places[nth]
        rows = np.empty((len(members), *field.rows.shape), dtype=field.rows.dtype)
        begin = int(self._dataset._begin[place])
        for person, member in enumerate(members.tolist()):
            field.read(begin + member, plan.shifts[nth], plan.mirrored[nth], rows[person])
        if not self._augmenter.steps or self._store.field(field.name).codebook is not None:
            return rows
        roots = self._roots(field.name, rows)
        about = None if roots is None else centroid(roots)
        for person, member in enumerate(members.tolist()):
            rows[person] = self._augmenter.rows(field.name, rows[person], plan.epoch, place, member, about)
        return rows

    def _roots(self, name: str, rows: Array) -> Array | None:
        """Return the places of roots in the first row, (P, 3); None where columns hold none, or are not known."""
        field = self._sample_fields[name]
        spatial = None if field.representation is None else field.representation.spatial
        places = [] if spatial is None else [root_place(spatial, of_dancer[0], field.columns) for of_dancer in rows]
        roots = [place for place in places if place is not None]
        return np.stack(roots) if roots else None
