"""The same dance to the same music, faster or slower."""

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal

from dancedata.augment._parameters import require_number, require_seed
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.grid import as_fraction
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.typing import override


@AUGMENTATIONS.register("tempo")
@dataclass(frozen=True)
class Tempo(CopyAugmentation):
    """Motion and music at another speed: what happens at t seconds of a clip happens at t / speed of its copy.

    The motion is resampled on the recipe's grid from the source's frames, the music is stretched by a phase vocoder,
    which keeps its pitch, and features, windows, contacts, key motions and the tempo in BPM are those of the new
    motion and music. Copies work for every representation.

    Samples cannot be changed when they are read: features would have to be recomputed from the stretched music.

    Attributes
    ----------
    speeds
        Each copy has one of these, 1.1 being 10 % faster. A short list lets clips share stretched songs.
    seed
        Seed of the copies: what is drawn for each is a pure function of (seed, clip id).
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"
    changes: ClassVar[Literal["rows", "motion", "time"]] = "time"

    speeds: tuple[float, ...] = (0.9, 1.1)
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.speeds, tuple) or not self.speeds:
            raise UsageError("tempo: speeds names no speed", found=self.speeds, allowed="a list such as [0.9, 1.1]")
        for speed in self.speeds:
            require_number("tempo: a speed", speed, 0.25, 4, "times the clip's")
        require_seed(self.seed)

    @override
    def speed(self, clip: str) -> Fraction:
        chosen = Draw.of_clip(self.seed, clip).below(len(self.speeds))
        return as_fraction(self.speeds[chosen], "tempo: a speed")
