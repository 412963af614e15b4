"""Beats and downbeats by the network of Beat This!: stretches of a song, and the peaks of their logits.

As the package beat_this 1.1 does with its postprocessor ``minimal``.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from dancedata.audio.beats.log_mel import HOP, MIN_SAMPLES, SAMPLE_RATE, log_mel
from dancedata.audio.beats.network import BeatNetwork
from dancedata.audio.beats.track import BeatTrack
from dancedata.audio.signal import resample
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid

#: Frames that the network sees at once (30 s), and those on each side whose logits are not used.
_STRETCH, _BORDER = 1500, 6
_KEPT = _STRETCH - 2 * _BORDER
#: Frames within which only the largest logit is a peak, 70 ms to each side.
_WITHIN = 7
#: Rate of the beats' frames: two equal peaks side by side are one beat between them.
GRID = FrameGrid.of(2 * SAMPLE_RATE // HOP)


def network_beats(signal: AudioSignal, network: BeatNetwork, device: torch.device) -> BeatTrack:
    """Return the beats and downbeats of a signal.

    Raises
    ------
    DataError
        "short_audio" for less than 24 ms; "overflow" if the network gives values that are not finite.
    """
    samples = resample(signal.samples, signal.sample_rate, SAMPLE_RATE)
    if len(samples) < MIN_SAMPLES:
        raise DataError(
            "beats: the audio is too short for a spectrum",
            reason="short_audio",
            found=f"{signal.n_samples} samples at {signal.sample_rate} Hz",
            allowed=f"at least {MIN_SAMPLES} samples at {SAMPLE_RATE} Hz",
        )
    with torch.inference_mode():
        logits = song_logits(network, log_mel(torch.from_numpy(samples.copy()).to(device))).cpu().numpy()
    if not np.isfinite(logits).all():
        raise DataError("beats: the network gave values that are not finite", reason="overflow", found="NaN")
    return beats_of(logits)


def song_logits(network: BeatNetwork, spectrum: torch.Tensor) -> torch.Tensor:
    """Return the logits (T, 2) of a spectrum (T, 128) of any length, from stretches of 30 s.

    Neighbouring stretches overlap; where they do, the earlier one counts.
    """
    n_frames = len(spectrum)
    starts = list(range(-_BORDER, n_frames - _BORDER, _KEPT))
    if n_frames > _KEPT:
        # The last stretch is a whole one too.
        starts[-1] = n_frames + _BORDER - _STRETCH
    logits = spectrum.new_empty((n_frames, 2))
    for start in reversed(starts):
        end = start + _STRETCH
        part = spectrum[max(start, 0) : end]
        padding = (0, 0, max(0, -start), max(0, min(_BORDER, end - n_frames)))
        kept = network(torch.nn.functional.pad(part, padding))[_BORDER:-_BORDER]
        logits[start + _BORDER : start + _BORDER + len(kept)] = kept
    return logits


def beats_of(logits: NDArray[np.float32]) -> BeatTrack:
    """Return the beats of logits (T, 2); the beat nearest to a peak of the second column begins a bar."""
    beats, downbeats = (_peaks(column) for column in logits.T)
    flags = np.zeros(len(beats), dtype=np.bool_)
    if len(beats):
        # In seconds, as there: which of two equally near beats it is, rounding decides.
        seconds, wanted = beats / float(GRID.rate), downbeats / float(GRID.rate)
        flags[np.abs(seconds - wanted[:, None]).argmin(axis=1)] = True
    return BeatTrack(beats, flags, GRID)


def _peaks(logits: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the peaks above 0, in half frames; two peaks side by side are one between them."""
    largest = maximum_filter1d(logits, _WITHIN, mode="constant", cval=-np.inf)
    frames = np.flatnonzero((logits == largest) & (logits > 0)).tolist()
    found: list[int] = []
    nth = 0
    while nth < len(frames):
        pair = frames[nth + 1 : nth + 2] == [frames[nth] + 1]
        found.append(2 * frames[nth] + pair)
        nth += 1 + pair
    return np.asarray(found, dtype=np.int64)
