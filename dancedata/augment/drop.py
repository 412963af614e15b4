"""Masked fields, for classifier-free guidance."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.augment._parameters import require_number
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.plugins import SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.typing import override


@AUGMENTATIONS.register("drop")
@dataclass(frozen=True)
class Drop(SampleAugmentation):
    """Fields of a sample that are masked with a probability, for classifier-free guidance (Ho and Salimans 2022).

    All rows of a masked field are 0, after normalising, and of codes the pad; ``<field>_dropped`` is true in the
    sample: a trainer puts its embedding of "no condition" there. EDGE masks its music with a probability of 0.25. It
    works on reading, for every field.

    Attributes
    ----------
    fields
        Fields that may be masked. Default: all fields of music.
    p
        Probability.
    together
        Whether all of them are masked together, or each by itself.
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"

    fields: tuple[str, ...] = ()
    p: float = 0.25
    together: bool = True

    def __post_init__(self) -> None:
        require_number("drop: p", self.p, 0, 1, "as a probability")
        if not isinstance(self.fields, tuple) or not all(isinstance(name, str) for name in self.fields):
            raise UsageError(
                "drop: fields is not a list of names", found=self.fields, allowed='such as ["librosa35"]'
            )

    @override
    def droppable(self, fields: Sequence[SampleField]) -> tuple[str, ...]:
        names = [field.name for field in fields]
        for name in self.fields:
            if name not in names:
                raise UsageError(f"drop: the field {name!r} is not read", fix=did_you_mean(name, names))
        droppable = self.fields or tuple(field.name for field in fields if field.kind == "audio")
        if not droppable:
            raise UsageError("drop: no field of music is read", found=", ".join(names),
                             fix='name fields, {"drop": {"fields": [...]}}')  # fmt: skip
        return droppable

    @override
    def dropped(self, fields: Sequence[SampleField], draw: Draw) -> tuple[str, ...]:
        names = self.droppable(fields)
        chances = [draw.uniform() for _ in names]
        return tuple(name for k, name in enumerate(names) if chances[0 if self.together else k] < self.p)
