"""Augmenter: the augmentations of a reader's samples, as pure functions of (seed, epoch, index)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleAugmentation, SampleField
from dancedata.core.rotations import Float64Array
from dancedata.core.sample_steps import Step, numbered
from dancedata.core.typing import override
from dancedata.store.dataset import Store
from dancedata.store.motion_fields import sample_field
from dancedata.torch.sample_changes import SampleChanges

#: Keeps these streams apart from those of order, mirroring and primitives, which may have the same seed.
_AUGMENT_STREAM = 4
#: Streams of an augmentation: whether a sample is changed, and by which numbers.
_WHETHER, _WHAT = 0, 1


@dataclass(frozen=True)
class Augmenter(SampleChanges):
    """Changes samples by augmentations; `fields` are the fields of samples, as augmentations see them."""

    fields: tuple[SampleField, ...] = ()
    seed: int = 0

    @classmethod
    def of(
        cls,
        store: Store,
        names: Sequence[str],
        steps: Iterable[Step],
        *,
        seed: int,
        mirrored: bool = False,
        allow_crop: bool = True,
    ) -> Augmenter:
        """Make an augmenter for samples with some fields; UsageError for an augmentation that cannot change them."""
        steps = tuple(numbered(steps))
        sample_fields = check_steps(steps, names, store)
        for step in steps:
            if step.augmentation.chooses_windows and not allow_crop:
                raise UsageError(f"the augmentation {step.name} chooses windows, and whole clips are read",
                                 fix="read windows: WindowDataset(..., augment=['crop'])")  # fmt: skip
            if mirrored and step.mirrors:
                raise UsageError("samples are mirrored twice", found=step.name, fix="name one mirror in augment")
        droppable = tuple(
            dict.fromkeys(name for step in steps for name in step.augmentation.droppable(sample_fields))
        )
        return cls(steps, droppable, sample_fields, seed)

    @property
    @override
    def crops(self) -> bool:
        return any(step.augmentation.chooses_windows for step in self.steps)

    @override
    def start(self, start: int, starts: range, stride: int, epoch: int, index: int) -> int:
        for step in self._active_steps(epoch, index):
            if step.augmentation.chooses_windows:
                start = step.augmentation.choose_start(start, starts, stride, self._draw(step, epoch, index))
        return start

    @override
    def rows(
        self,
        field: str,
        rows: npt.NDArray[Any],
        epoch: int,
        index: int,
        member: int | None = None,
        about: Float64Array | None = None,
    ) -> npt.NDArray[Any]:
        sample_field = next(candidate for candidate in self.fields if candidate.name == field)
        if sample_field.kind == "audio":
            return rows
        for step in self._active_steps(epoch, index):
            read_only = rows.view()
            read_only.flags.writeable = False
            plugin, key = step.augmentation, (epoch, index, _WHAT)
            if member is None:
                changed = np.asarray(plugin.change_sample(read_only, sample_field, self._draw(step, *key)))
            elif plugin.acts_on == "body":
                changed = np.asarray(plugin.change_sample(read_only, sample_field, self._draw(step, *key, member)))
            else:
                changed = np.asarray(
                    plugin.change_sample(read_only, sample_field, self._draw(step, *key), about=about)
                )
            if changed is read_only:
                continue
            if changed.shape != rows.shape:
                raise UsageError(f"the augmentation {step.name} changes the shape of rows", where=f"field {field}",
                                 found=changed.shape, allowed=rows.shape)  # fmt: skip
            rows = changed.astype(rows.dtype, copy=False)
        return rows

    @override
    def dropped(self, epoch: int, index: int) -> tuple[str, ...]:
        if not self.droppable:
            return ()
        names: list[str] = []
        for step in self._active_steps(epoch, index):
            names += step.augmentation.dropped(self.fields, self._draw(step, epoch, index))
        return tuple(dict.fromkeys(names))

    @override
    def changes(self, epoch: int, index: int) -> tuple[str, ...]:
        return tuple(step.augmentation.name for step in self._active_steps(epoch, index))

    def _active_steps(self, epoch: int, index: int) -> Iterator[Step]:
        for step in self.steps:
            if step.p >= 1 or (step.p > 0 and self._draw(step, epoch, index, _WHETHER).uniform() < step.p):
                yield step

    def _draw(self, step: Step, epoch: int, index: int, what: int = _WHAT, *member: int) -> Draw:
        return Draw(self.seed, _AUGMENT_STREAM, step.stream, epoch, index, what, *member)


def check_steps(steps: Sequence[Step], names: Sequence[str], store: Store) -> tuple[SampleField, ...]:
    """Return fields of samples; UsageError if an augmentation cannot change samples with them."""
    sample_fields = tuple(sample_field(store, name) for name in names)
    for step, field in product(steps, sample_fields):
        changes_rows = type(step.augmentation).change_sample is not SampleAugmentation.change_sample
        codebook = store.field(field.name).codebook
        if codebook is not None and changes_rows and field.kind != "audio":
            raise UsageError(f"the augmentation {step.name} cannot change codes", where=str(store.path),
                             found=f"field {field.name}, codes of {codebook.name}",
                             fix="leave out the field, or the augmentation")  # fmt: skip
        step.check(field, str(store.path))
    return sample_fields
