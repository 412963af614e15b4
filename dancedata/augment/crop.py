"""Windows at random places of their clips."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.plugins import SampleAugmentation
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.typing import override


@AUGMENTATIONS.register("crop")
@dataclass(frozen=True)
class Crop(SampleAugmentation):
    """A window of the same length at a random frame of the same clip, with its own rows of music.

    The length is that of the windows that are read, of any number of frames (`length_s`, `length_frames`). It works
    on reading, for every representation.

    Attributes
    ----------
    within
        "clip": every frame at which such a window of the clip can begin is equally likely. "stride": a frame from the
        window's own first one to before that of the next window, so that an epoch covers a clip evenly.
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"
    chooses_windows: ClassVar[bool] = True

    within: Literal["clip", "stride"] = "clip"

    def __post_init__(self) -> None:
        if self.within not in ("clip", "stride"):
            raise UsageError("crop: unknown value of within", found=self.within, allowed="clip or stride")

    @override
    def choose_start(self, start: int, starts: range, stride: int, draw: Draw) -> int:
        near = starts if self.within == "clip" else range(start, min(start + stride, starts.stop), starts.step)
        return near[draw.below(len(near))]
