"""Augmenter: the augmentations of a reader's samples, as pure functions of (seed, epoch, index)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleAugmentation, SampleField
from dancedata.core.rotations import Float64Array
from dancedata.core.sample_steps import Step, numbered
from dancedata.store.dataset import Store
from dancedata.store.motion_fields import sample_field

#: Keeps these streams apart from those of order, mirroring and primitives, which may have the same seed.
_AUGMENT_STREAM = 4
#: Streams of an augmentation: whether a sample is changed, and by which numbers.
_WHETHER, _WHAT = 0, 1


@dataclass(frozen=True)
class Augmenter:
    """Changes samples, without state: any thread, worker and rank gets the same sample for (seed, epoch, index)."""

    fields: tuple[SampleField, ...]
    steps: tuple[Step, ...]
    seed: int
    droppable: tuple[str, ...]

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
        sample_fields = tuple(sample_field(store, name) for name in names)
        steps = tuple(numbered(steps))
        for step in steps:
            check_step(step, sample_fields, store)
            if step.augmentation.chooses_windows and not allow_crop:
                raise UsageError(f"the augmentation {step.name} chooses windows, and whole clips are read",
                                 fix="read windows: WindowDataset(..., augment=['crop'])")  # fmt: skip
            if mirrored and step.mirrors:
                raise UsageError("samples are mirrored twice", found=step.name, fix="name one mirror in augment")
        droppable = tuple(
            dict.fromkeys(name for step in steps for name in step.augmentation.droppable(sample_fields))
        )
        return cls(sample_fields, steps, seed, droppable)

    @property
    def crops(self) -> bool:
        """Whether windows other than the listed ones are read."""
        return any(step.augmentation.chooses_windows for step in self.steps)

    def start(self, start: int, starts: range, stride: int, epoch: int, index: int) -> int:
        """Return the first frame of the window of sample `index`; see `SampleAugmentation.choose_start`."""
        for step in self._active_steps(epoch, index):
            if step.augmentation.chooses_windows:
                start = step.augmentation.choose_start(start, starts, stride, self._draw(step, epoch, index))
        return start

    def rows(
        self,
        field: str,
        rows: npt.NDArray[Any],
        epoch: int,
        index: int,
        member: int | None = None,
        about: Float64Array | None = None,
    ) -> npt.NDArray[Any]:
        """Return the rows of a field of sample `index`, (L, D), not normalised; the same array if nothing changes it.

        The input array is not modified. Of a group's sample, `member` is the dancer's number and `about` a point of
        the axis that they turn about.
        """
        if not self.steps:
            return rows
        sample_field = next(candidate for candidate in self.fields if candidate.name == field)
        if sample_field.kind in ("audio", "scene"):
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

    def dropped(self, epoch: int, index: int) -> tuple[str, ...]:
        """Return the names of the fields of sample `index` that are masked."""
        if not self.droppable:
            return ()
        names: list[str] = []
        for step in self._active_steps(epoch, index):
            names += step.augmentation.dropped(self.fields, self._draw(step, epoch, index))
        return tuple(dict.fromkeys(names))

    def changes(self, epoch: int, index: int) -> tuple[str, ...]:
        """Return the names of the augmentations that change sample `index`, in their order."""
        return tuple(step.augmentation.name for step in self._active_steps(epoch, index))

    def _active_steps(self, epoch: int, index: int) -> Iterator[Step]:
        for step in self.steps:
            if step.p >= 1 or (step.p > 0 and self._draw(step, epoch, index, _WHETHER).uniform() < step.p):
                yield step

    def _draw(self, step: Step, epoch: int, index: int, what: int = _WHAT, *member: int) -> Draw:
        return Draw(self.seed, _AUGMENT_STREAM, step.stream, epoch, index, what, *member)


def check_step(step: Step, sample_fields: Sequence[SampleField], store: Store) -> None:
    """Raise UsageError if an augmentation cannot change samples with these fields."""
    augmentation = step.augmentation
    changes_rows = type(augmentation).change_sample is not SampleAugmentation.change_sample
    for field in sample_fields:
        codebook = store.field(field.name).codebook
        if codebook is not None and changes_rows and field.kind != "audio":
            raise UsageError(f"the augmentation {step.name} cannot change codes", where=str(store.path),
                             found=f"field {field.name}, codes of {codebook.name}",
                             fix="leave out the field, or the augmentation")  # fmt: skip
        step.check(field, str(store.path))
