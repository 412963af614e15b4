"""Augmenter: the augmentations of a reader's samples, as pure functions of (seed, epoch, index)."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Augmentation, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.readers.arguments import probability
from dancedata.store.dataset import Store
from dancedata.store.motion_fields import stored_contacts, stored_representation
from dancedata.store.normalize import MinMax

#: Keeps these streams apart from those of order, mirroring and primitives, which may have the same seed.
_AUGMENT_STREAM = 4
#: Streams of an augmentation: whether a sample is changed, and by which numbers.
_WHETHER, _WHAT = 0, 1


def _sample_field(store: Store, name: str) -> SampleField:
    """Return a field with the plug-ins that made it, if the dataset's recipe names installed ones."""
    field, recipe = store.field(name), store.meta.get("recipe")
    plain = SampleField(name, field.kind, field.columns, field.grid)
    if field.kind != "motion":
        return plain
    try:
        representation, contacts = stored_representation(recipe, name, field.columns), stored_contacts(recipe, name)
    except UsageError:
        return plain
    if representation.default_contacts is not None and contacts is None:
        return plain
    return replace(plain, representation=representation, contacts=contacts)


@dataclass(frozen=True)
class Chance:
    """An augmentation that changes a sample with a probability.

    `p`: Probability.
    """

    augmentation: SampleAugmentation
    p: float

    def __post_init__(self) -> None:
        probability("p", self.p)


#: Type of the argument `augment` of readers, see `Augmenter.of`.
Augment = Sequence[SampleAugmentation | Chance | str | Mapping[str, Any]] | Mapping[str, Any]


@dataclass(frozen=True)
class _Step:
    """An augmentation under a unique name, which chooses its random numbers."""

    name: str
    augmentation: SampleAugmentation
    p: float

    @property
    def stream(self) -> int:
        """Number of the stream of random numbers: equal names give equal numbers, in any order of the steps."""
        return zlib.crc32(self.name.encode())


@dataclass(frozen=True)
class Augmenter:
    """Changes samples. It has no state: any thread, worker and rank gets the same sample for (seed, epoch, index).

    `fields`: The fields of samples.
    `steps`: The augmentations, in their order.
    `droppable`: Names of the fields that may be masked.
    """

    fields: tuple[SampleField, ...]
    steps: tuple[_Step, ...]
    seed: int
    droppable: tuple[str, ...]

    @classmethod
    def of(
        cls,
        store: Store,
        names: Sequence[str],
        augment: Augment | None,
        *,
        seed: int,
        mirrored: bool = False,
        allow_crop: bool = True,
    ) -> Augmenter:
        """Make an augmenter for samples with some fields of a store.

        `augment`: Plug-ins, names, or mappings of names to parameters, among which ``"p"`` is the probability that a
            sample is changed. A number instead of parameters is that probability; True: always, False: never.
        `mirrored`: Whether samples are mirrored by other means already.
        `allow_crop`: Whether windows other than the stored ones may be read.
        Raises UsageError: for an unknown augmentation or parameter, and for one that cannot change these samples.
        """
        sample_fields = tuple(_sample_field(store, name) for name in names)
        steps = tuple(_numbered(_steps(augment)))
        for step in steps:
            _check(step, sample_fields, store)
            _check_windows(step, store, allow_crop)
            if mirrored and step.augmentation.name == "mirror":
                raise UsageError(
                    "samples are mirrored twice", fix="give mirror= or augment={'mirror': ...}, not both"
                )
        droppable = tuple(
            dict.fromkeys(name for step in steps for name in step.augmentation.droppable(sample_fields))
        )
        return cls(sample_fields, steps, seed, droppable)

    @classmethod
    def covering(cls, store: Store, names: Sequence[str], augment: Augment) -> Augmenter:
        """Make an augmenter for its `scaler` alone; UsageError as `of`, except for windows and masked fields."""
        sample_fields = tuple(_sample_field(store, name) for name in names)
        steps = tuple(_steps(augment))
        for step in steps:
            _check(step, sample_fields, store)
        return cls(sample_fields, steps, 0, ())

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

    def scaler(self, field: str, scaler: MinMax) -> MinMax:
        """Return the scaler of a field whose range covers what augmentations make of motion."""
        sample_field = next(candidate for candidate in self.fields if candidate.name == field)
        if sample_field.kind != "motion":
            return scaler
        low, high = scaler.data_min, scaler.data_max
        for step in self.steps:
            if step.p > 0:
                low, high = step.augmentation.scaler_bounds(low, high, sample_field)
        return scaler if low is scaler.data_min and high is scaler.data_max else scaler.with_range(low, high)

    def _active_steps(self, epoch: int, index: int) -> Iterator[_Step]:
        for step in self.steps:
            if step.p >= 1 or (step.p > 0 and self._draw(step, epoch, index, _WHETHER).uniform() < step.p):
                yield step

    def _draw(self, step: _Step, epoch: int, index: int, what: int = _WHAT, *member: int) -> Draw:
        return Draw(self.seed, _AUGMENT_STREAM, step.stream, epoch, index, what, *member)


def _steps(augment: Augment | None) -> Iterator[_Step]:
    if isinstance(augment, str | Augmentation | Chance):
        raise UsageError("augment is not a list", found=augment, allowed='such as ["yaw"] or {"mirror": 0.5}')
    items: Sequence[Any] = [augment] if isinstance(augment, Mapping) else augment or []
    for item in items:
        if isinstance(item, Chance):
            yield _step(item.augmentation.name, item.augmentation, item.p)
        elif isinstance(item, Augmentation):
            yield _step(item.name, item, 1.0)
        elif isinstance(item, str):
            yield _named(item, None)
        elif isinstance(item, Mapping):
            yield from (_named(name, parameters) for name, parameters in item.items() if parameters is not False)
        else:
            raise UsageError("not an augmentation", found=item, allowed="a plug-in, a name, or {name: parameters}")


def _named(name: str, entry: Any) -> _Step:
    """Make a step from a name, PLUGIN or PLUGIN.NAME, and parameters or a probability."""
    plugin = name if name in AUGMENTATIONS.names() else str(name).partition(".")[0]
    cls: type[Any] = AUGMENTATIONS.get(plugin)
    if isinstance(entry, int | float) and not isinstance(entry, bool):
        entry = {"p": entry}
    if entry is not None and entry is not True and not isinstance(entry, Mapping):
        raise UsageError(
            f"augment: {name}: neither parameters nor a probability", found=entry, allowed='such as {"p": 0.5}'
        )
    parameters = dict(entry) if isinstance(entry, Mapping) else {}
    chance = 1.0
    if "p" not in {f.name for f in fields(cls)}:
        chance = probability(f"augment: {name}: p", parameters.pop("p", 1.0))
    return _step(str(name), AUGMENTATIONS.make(plugin, parameters), chance)


def _step(name: str, augmentation: Augmentation, chance: float) -> _Step:
    """Make a step; UsageError for an augmentation that does not change samples."""
    if not isinstance(augmentation, SampleAugmentation):
        raise UsageError(
            f"the augmentation {name} makes copies when a dataset is built, and does not change samples",
            fix=f"build with augment: {{{augmentation.name}: {{}}}}, or derive its class from SampleAugmentation",
        )
    return _Step(name, augmentation, chance)


def _numbered(steps: Iterator[_Step]) -> Iterator[_Step]:
    """Yield steps under different names, so that steps with the same name draw different numbers."""
    counts: dict[str, int] = {}
    for step in steps:
        nth = counts[step.name] = counts.get(step.name, 0) + 1
        yield step if nth == 1 else _Step(f"{step.name}#{nth}", step.augmentation, step.p)


def _check(step: _Step, sample_fields: Sequence[SampleField], store: Store) -> None:
    """Raise UsageError if an augmentation cannot change samples with these fields."""
    augmentation = step.augmentation
    changes_rows = type(augmentation).change_sample is not SampleAugmentation.change_sample
    for field in sample_fields:
        codebook = store.field(field.name).codebook
        if codebook is not None and changes_rows and field.kind != "audio":
            raise UsageError(f"the augmentation {step.name} cannot change codes", where=str(store.path),
                             found=f"field {field.name}, codes of {codebook.name}",
                             fix="leave out the field, or the augmentation")  # fmt: skip
        try:
            augmentation.check_sample(field)
        except UsageError as error:
            raise UsageError(
                f"the augmentation {step.name} cannot change field {field.name!r}: {error}", where=str(store.path)
            ) from error


def _check_windows(step: _Step, store: Store, allow_crop: bool) -> None:
    """Raise UsageError if an augmentation cannot choose windows here."""
    augmentation = step.augmentation
    if augmentation.chooses_windows and not allow_crop:
        raise UsageError(f"the augmentation {step.name} chooses windows, and whole clips are read",
                         fix="read windows: WindowDataset(..., augment=['crop'])")  # fmt: skip
    if augmentation.chooses_windows and store.scope == "window":
        raise UsageError(f"the augmentation {step.name} reads windows other than the stored ones",
                         where=str(store.path),
                         found="a dataset of window scope, which holds only the windows that were built",
                         fix="build with scope: track")  # fmt: skip
