"""Windows of equal length at a constant stride: the one place that counts them."""

from __future__ import annotations

from dataclasses import dataclass

from dancedata.core.errors import UsageError


@dataclass(frozen=True)
class WindowGrid:
    """Windows of `length` frames, one every `stride` frames: window k begins at frame k * stride.

    Raises
    ------
    UsageError
        If length or stride is below one frame.
    """

    length: int
    stride: int

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.length < 1 or self.stride < 1:
            raise UsageError(
                "windows need a length and a stride of at least one frame",
                found=f"length {self.length}, stride {self.stride}",
            )

    def count(self, n_frames: int) -> int:
        """Return how many windows fit into `n_frames` frames."""
        return (n_frames - self.length) // self.stride + 1 if n_frames >= self.length else 0

    def start(self, number: int) -> int:
        """Return the first frame of a window."""
        return number * self.stride

    def number(self, start: int) -> int:
        """Return the number of the window that begins at frame `start`."""
        return start // self.stride

    def starts(self, count: int) -> range:
        """Return the first frames of the first `count` windows."""
        return range(0, count * self.stride, self.stride)

    def times(self, factor: int) -> WindowGrid:
        """Return the same windows counted at `factor` times the frame rate."""
        return WindowGrid(self.length * factor, self.stride * factor)
