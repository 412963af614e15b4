"""Frames of signals for the constant-Q filters, folded about the filters' point of symmetry."""

from __future__ import annotations

from typing import Any

import numpy as np

from dancedata.audio.librosa35.arrays import Floats, strided


class Frames:
    """Frames of 2 `half` samples of signals, `hop` apart.

    Parameters
    ----------
    samples
        (W, n) float32, padded with zeros.
    lead
        Samples by which frame 0 begins before the signal.
    n_frames
        Frames per signal.
    """

    def __init__(self, samples: Floats, lead: int, half: int, hop: int, n_frames: int) -> None:
        n_signals, n_samples = samples.shape
        needed = max(lead + n_samples, (n_frames - 1) * hop + 2 * half + 1)
        padded = np.zeros((n_signals, needed), dtype=np.float32)
        padded[:, lead : lead + n_samples] = samples
        mirrored = np.ascontiguousarray(padded[:, ::-1])
        shape = (n_signals, n_frames, half)
        # From one sample after the middle on, and from the middle backwards: m + 1 + j and m - j.
        self._after = strided(padded, shape, (needed, hop, 1), half + 1)
        self._before = strided(mirrored, shape, (needed, -hop, 1), needed - 1 - half)
        self._ends = strided(padded, (n_signals, n_frames, 2), (needed, hop, 1))

    def folded(self, combine: Any, part: slice) -> Floats:
        """Return sums (`np.add`) or differences (`np.subtract`) of samples at equal distances; (W F, half).

        Those are x[m + 1 + j] and x[m - j], m = half. The filters are periodic, so the partner of x[1] is x[0].
        """
        after = self._after[:, part]
        folded: Floats = np.empty(after.shape, dtype=np.float32)
        self._fold(combine, part, folded)
        return folded.reshape(-1, after.shape[2])

    def fold_into(self, combine: Any, out: Floats) -> None:
        """Write the sums or differences of all frames into an array (W, n_frames, half)."""
        self._fold(combine, slice(None), out)

    def _fold(self, combine: Any, part: slice, out: Floats) -> None:
        ends = self._ends[:, part]
        combine(self._after[:, part], self._before[:, part], out=out)
        combine(ends[..., 0], ends[..., 1], out=out[..., -1])
