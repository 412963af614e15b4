"""Cutting a signal into overlapping chunks, whose middles are kept."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise


@dataclass(frozen=True)
class Timing:
    """When the frames of an encoder are, in samples at its own rate.

    Attributes
    ----------
    sample_rate
        In Hz.
    hop
        Samples from one frame to the next.
    first_centre
        Centre of the first frame, counted from the first sample that the encoder is given.
    """

    sample_rate: int
    hop: Fraction
    first_centre: Fraction

    @property
    def rate(self) -> Fraction:
        """Frames per second."""
        return self.sample_rate / self.hop


@dataclass(frozen=True)
class Chunk:
    """A part of a signal that the encoder processes at once.

    Attributes
    ----------
    start, n_samples
        Samples of the signal.
    keep_from, keep_to
        Between these times, in samples of the signal, the chunk's frames count; None: no limit.
    """

    start: int
    n_samples: int
    keep_from: Fraction | None
    keep_to: Fraction | None


def chunks_of(n_samples: int, *, length: int, overlap: int, unit: int, timing: Timing) -> list[Chunk]:
    """Cut a signal into chunks of `length` samples that overlap by at least `overlap`.

    All begin at a multiple of `unit` samples. The last one ends with the signal and has as much before it as the
    others, so that all of its frames see enough of their past; it is up to `unit` - 1 samples shorter. In the
    middle of an overlap the earlier chunk's frames end and the later one's begin, at the border of two frames.

    Parameters
    ----------
    n_samples
        Samples of the signal, at the encoder's rate.
    length, overlap, unit
        In samples; `length` and `overlap` are multiples of `unit`, `overlap` is less than `length`.
    """
    if n_samples <= length:
        return [Chunk(0, n_samples, None, None)]
    last = -(-(n_samples - length) // unit) * unit
    starts = [*range(0, last, length - overlap), last]
    borders = [_border(timing, later, Fraction(later + earlier + length, 2)) for earlier, later in pairwise(starts)]
    return [
        Chunk(start, min(length, n_samples - start), keep_from, keep_to)
        for start, keep_from, keep_to in zip(starts, [None, *borders], [*borders, None], strict=True)
    ]


def _border(timing: Timing, start: int, near: Fraction) -> Fraction:
    """Return the border of two frames of a chunk that is nearest to a time."""
    first = start + timing.first_centre - timing.hop / 2
    return first + round((near - first) / timing.hop) * timing.hop
