"""SampleChanges: what augmentations change in a reader's samples. Here it is nothing, as where none is named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from dancedata.core.rotations import Float64Array

if TYPE_CHECKING:
    from dancedata.core.sample_steps import Augment, Step


def steps_named(augment: Augment) -> tuple[Step, ...]:
    """Return the steps that `steps_of` yields; augmentations are loaded where there are some."""
    if isinstance(augment, tuple) and not augment:
        return ()
    from dancedata.core.sample_steps import steps_of

    return tuple(steps_of(augment))


@dataclass(frozen=True)
class SampleChanges:
    """Changes of samples, without state: any thread, worker and rank gets the same for (seed, epoch, index)."""

    steps: tuple[Step, ...] = ()
    droppable: tuple[str, ...] = ()

    @property
    def crops(self) -> bool:
        """Whether windows other than the listed ones are read."""
        return False

    def start(self, start: int, starts: range, stride: int, epoch: int, index: int) -> int:
        """Return the first frame of the window of sample `index`; see `SampleAugmentation.choose_start`."""
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
        """Return the changed rows of a field of sample `index`, (L, D), not normalised; `about`: a group's axis."""
        return rows

    def dropped(self, epoch: int, index: int) -> tuple[str, ...]:
        """Return the names of the fields of sample `index` that are masked."""
        return ()

    def changes(self, epoch: int, index: int) -> tuple[str, ...]:
        """Return the names of the augmentations that change sample `index`, in their order."""
        return ()
