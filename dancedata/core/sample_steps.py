"""Augmentations of samples as callers name them: plug-ins with the probability that they change a sample."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from dancedata.core.arguments import probability
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Augmentation, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS


@dataclass(frozen=True)
class RandomAugmentation:
    """An augmentation that changes a sample with the probability `p`."""

    augmentation: SampleAugmentation
    p: float

    def __post_init__(self) -> None:
        probability("p", self.p)


#: Type of the argument `augment` of readers, see `steps_of`.
Augment = Sequence[SampleAugmentation | RandomAugmentation | str | Mapping[str, Any]] | Mapping[str, Any]


@dataclass(frozen=True)
class Step:
    """An augmentation under a unique name, which chooses its random numbers."""

    name: str
    augmentation: SampleAugmentation
    p: float

    @property
    def mirrors(self) -> bool:
        """Whether samples are mirror images, which have their own words, and a fast way to be read."""
        return self.augmentation.name == "mirror"

    @property
    def stream(self) -> int:
        """Number of the stream of random numbers: equal names give equal numbers, in any order of the steps."""
        return zlib.crc32(self.name.encode())

    def check(self, field: SampleField, where: str) -> None:
        """Raise UsageError if the augmentation cannot change samples with a field."""
        try:
            self.augmentation.check_sample(field)
        except UsageError as error:
            raise UsageError(
                f"the augmentation {self.name} cannot change field {field.name!r}: {error}", where=where
            ) from error


def steps_of(augment: Augment | None) -> Iterator[Step]:
    """Yield the steps that plug-ins, names and mappings of names to parameters, or to a probability, stand for.

    ``"p"`` among the parameters is the probability that a sample is changed; True: always, False: never.
    """
    if isinstance(augment, str | Augmentation | RandomAugmentation) or not isinstance(augment, Iterable | None):
        raise UsageError("augment is not a list", found=augment, allowed='such as ["yaw"] or {"mirror": 0.5}')
    items: Sequence[Any] = [augment] if isinstance(augment, Mapping) else augment or []
    for item in items:
        if isinstance(item, RandomAugmentation):
            yield _step(item.augmentation.name, item.augmentation, item.p)
        elif isinstance(item, Augmentation):
            yield _step(item.name, item, 1.0)
        elif isinstance(item, str):
            yield _named(item, None)
        elif isinstance(item, Mapping):
            yield from (_named(name, parameters) for name, parameters in item.items() if parameters is not False)
        else:
            raise UsageError("not an augmentation", found=item, allowed="a plug-in, a name, or {name: parameters}")


def _named(name: str, entry: Any) -> Step:
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


def _step(name: str, augmentation: Augmentation, chance: float) -> Step:
    """Make a step; UsageError for an augmentation that does not change samples."""
    if not isinstance(augmentation, SampleAugmentation):
        raise UsageError(
            f"the augmentation {name} makes copies when a dataset is built, and does not change samples",
            fix=f"build with augment: {{{augmentation.name}: {{}}}}, or derive its class from SampleAugmentation",
        )
    return Step(name, augmentation, chance)


def numbered(steps: Iterable[Step]) -> Iterator[Step]:
    """Yield steps under different names, so that steps with the same name draw different numbers."""
    counts: dict[str, int] = {}
    for step in steps:
        nth = counts[step.name] = counts.get(step.name, 0) + 1
        yield step if nth == 1 else Step(f"{step.name}#{nth}", step.augmentation, step.p)
