"""Slices of takes, each a take by itself, as EDGE's scripts make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar

from dancedata.building.take import Scene, Take, Time, Transform
from dancedata.core.clip import slice_name
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.registry import TRANSFORMS
from dancedata.core.segments import Segment
from dancedata.core.typing import override


@TRANSFORMS.register("slices")
@dataclass(frozen=True)
class Slices(Transform):
    """Cuts clips into slices before anything is computed of them; each is a clip, ``ID_slice3``.

    Motion is cut at the rate of the source, where that is a whole multiple: 1,919 frames at 60 per second have 54
    slices of 5 s every 0.5 s; as 960 frames at 30 per second they would have 55. Music is cut in samples, and
    rounded to 16 bit.

    Attributes
    ----------
    length_s
        Length of a slice, seconds: a number, or a fraction such as "4/3".
    stride_s
        Seconds from one slice to the next.

    References
    ----------
    Tseng et al. (2023). EDGE: Editable Dance Generation From Music. CVPR; data/slice.py of Stanford-TML/EDGE.
    """

    version: ClassVar[int] = 1
    is_part: ClassVar[bool] = True
    not_for_groups: ClassVar[str] = "groups are stored whole"

    length_s: float | str = 5.0
    stride_s: float | str = 0.5

    @override
    def on(self, grid: FrameGrid) -> SlicesOnGrid:
        """Return the slices in frames of a recipe; UsageError unless length and stride are whole frames."""
        length, stride = grid.frames(self.length_s, "slices.length_s"), grid.frames(self.stride_s, "slices.stride_s")
        if min(length, stride) < 1:
            raise UsageError("slices: length and stride must be above 0", found=f"{self.length_s}, {self.stride_s}")
        return SlicesOnGrid(WindowSpec(length, stride, grid))


@dataclass(frozen=True)
class SlicesOnGrid(Transform):
    """Slices in frames of a recipe."""

    name: ClassVar[str] = "slices"
    version: ClassVar[int] = Slices.version

    excerpts: WindowSpec  # type: ignore[misc]

    def expand(self, take: Take) -> Sequence[Take]:
        """Return the slices of a take; UsageError for a group, and music that does not begin with its clip."""
        if take.group:
            raise UsageError(Slices.not_for_groups, where=f"group {take.group}", found="slices",
                             fix="build without slices")  # fmt: skip
        (dancer,) = take.dancers
        if dancer.music.start:
            raise UsageError("music that does not begin with its clip has no slices", where=f"clip {dancer.id}",
                             found=f"frame 0 at {float(dancer.music.start):g} s of the music",
                             fix="build without slices")  # fmt: skip
        windows, time = self.excerpts, take.time
        step = time.grid.step_to(windows.grid)
        count, at = windows.count(time.frames_on(windows.grid)), windows.grid
        if step is not None:
            count, at = min(count, windows.times(step).count(time.n_frames)), time.grid
        if not count:  # too short, by a part of a frame perhaps
            n_frames = min(time.frames_on(windows.grid), windows.length - 1)
            return [replace(take, time=Time(n_frames, windows.grid.rate))]
        return [self._slice(take, k, at) for k in range(count)]

    def _slice(self, take: Take, k: int, at: FrameGrid) -> Take:
        """Return a slice, cut at a rate."""
        (dancer,), first = take.dancers, self.excerpts.start(k)
        start, stop = (self.excerpts.grid.rows_down(frame, of=at) for frame in (first, first + self.excerpts.length))
        whole = replace(take.time, n_frames=take.time.frames_on(at), rate=at.rate, recorded=take.time.rate)
        music = replace(dancer.music, excerpt=k, start=at.seconds(start))
        dancer = replace(dancer, id=slice_name(dancer.id, k), slice_of=dancer.id, music=music)
        return take.then(Part(at.rate, start, stop), dancers=(dancer,), time=whole.part(start, stop))


@dataclass(frozen=True)
class Part(Transform):
    """Frames start .. stop - 1 at a rate."""

    name: ClassVar[str] = "part"
    version: ClassVar[int] = 1
    is_part: ClassVar[bool] = True

    rate: Fraction
    start: int
    stop: int

    def scene(self, scene: Scene) -> Scene:
        """Cut the motions."""
        at = FrameGrid(self.rate)
        return scene.with_motions([m.resampled(at).part(self.start, self.stop) for m in scene.motions])

    def segment(self, segment: Segment, take: Take) -> Segment | None:
        """Return a segment that a slice has a part of, moved."""
        shift, length = self.start / self.rate, (self.stop - self.start) / self.rate
        start, end = segment.start - shift, segment.end - shift
        # Rows near the end may be made of a frame beyond it.
        beyond = start >= length + segment.data.get("period", 0) or (end <= 0 and start < 0)
        return None if beyond else replace(segment, start=start, end=end)

    def key(self) -> list[Any]:
        """Return the frames and their rate."""
        return [self.name, self.version, str(self.rate), self.start, self.stop]
