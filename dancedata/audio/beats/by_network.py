"""Beats and downbeats by the network of Beat This!: a log-mel spectrum, stretches of it, the peaks of their logits.

Foscarin, Schlueter, Widmer, "Beat this! Accurate beat tracking without DBN postprocessing" (ISMIR 2024). The numbers
are those of the package beat_this 1.1 (`LogMelSpect`, without torchaudio) with its postprocessor ``minimal``.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from dancedata.audio.beats.network import BeatNetwork
from dancedata.audio.beats.track import BeatTrack
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.kernel import resample

SAMPLE_RATE, HOP, N_FFT, N_BANDS = 22050, 441, 1024, 128
_LOWEST_HZ, _HIGHEST_HZ = 30.0, 11000.0
_GAIN = 1000.0
#: Fewer samples cannot be continued by their mirror image.
MIN_SAMPLES = N_FFT // 2 + 1
# Slaney's mel scale (Auditory Toolbox, 1998): 15 mels up to 1 kHz, linear; from there 27 mels for a factor of 6.4.
_KNEE_HZ, _KNEE_MEL, _LINEAR_HZ = 1000.0, 15.0, 200.0 / 3
_LOG_STEP = math.log(6.4) / 27
#: Frames that the network sees at once (30 s), and those on each side whose logits are not used.
_STRETCH, _BORDER = 1500, 6
_KEPT = _STRETCH - 2 * _BORDER
#: Frames within which only the largest logit is a peak, 70 ms to each side.
_WITHIN = 7
#: Rate of the beats' frames: two equal peaks side by side are one beat between them.
GRID = FrameGrid.of(2 * SAMPLE_RATE // HOP)


def log_mel(samples: torch.Tensor) -> torch.Tensor:
    """Return the spectrum (1 + n // 441, 128) of samples (n,) float32 at 22,050 Hz, n >= `MIN_SAMPLES`."""
    spectrum = torch.stft(
        samples,
        N_FFT,
        hop_length=HOP,
        window=torch.hann_window(N_FFT, device=samples.device),
        center=True,
        pad_mode="reflect",
        normalized=True,
        return_complex=True,
    )
    bands = _filters().to(samples.device) @ spectrum.abs()
    return torch.log1p(_GAIN * bands).T


@lru_cache(maxsize=1)
def _filters() -> torch.Tensor:
    """Return the triangular filters (128, 513) on Slaney's mel scale, each 1 at its top.

    In float32, as those of the training were: where music is quiet, the logarithm shows their last digits.
    """
    bins = torch.linspace(0, SAMPLE_RATE // 2, N_FFT // 2 + 1)
    edges = _hertz(torch.linspace(_mel(_LOWEST_HZ), _mel(_HIGHEST_HZ), N_BANDS + 2))
    rise, fall = edges.diff()[:-1, None], edges.diff()[1:, None]
    return torch.minimum((bins - edges[:-2, None]) / rise, (edges[2:, None] - bins) / fall).clamp(min=0)


def _mel(hertz: float) -> float:
    return hertz / _LINEAR_HZ if hertz < _KNEE_HZ else _KNEE_MEL + math.log(hertz / _KNEE_HZ) / _LOG_STEP


def _hertz(mel: torch.Tensor) -> torch.Tensor:
    return torch.where(mel < _KNEE_MEL, mel * _LINEAR_HZ, _KNEE_HZ * torch.exp(_LOG_STEP * (mel - _KNEE_MEL)))


def network_beats(signal: AudioSignal, network: BeatNetwork, device: torch.device) -> BeatTrack:
    """Return the beats and downbeats of a signal; DataError "short_audio" (less than 24 ms) or "overflow"."""
    samples = resample(signal.samples, signal.sample_rate, SAMPLE_RATE)
    if len(samples) < MIN_SAMPLES:
        raise DataError("beats: the audio is too short for a spectrum", reason="short_audio",
                        found=f"{signal.n_samples} samples at {signal.sample_rate} Hz",
                        allowed=f"at least {MIN_SAMPLES} samples at {SAMPLE_RATE} Hz")  # fmt: skip
    with torch.inference_mode():
        logits = song_logits(network, log_mel(torch.from_numpy(samples.copy()).to(device))).cpu().numpy()
    if not np.isfinite(logits).all():
        raise DataError("beats: the network gave values that are not finite", reason="overflow", found="NaN")
    return beats_of(logits)


def song_logits(network: BeatNetwork, spectrum: torch.Tensor) -> torch.Tensor:
    """Return the logits (T, 2) of a spectrum (T, 128) of any length, from stretches of 30 s."""
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
        # In seconds, as there: rounding decides between two equally near beats.
        seconds, wanted = beats / float(GRID.rate), downbeats / float(GRID.rate)
        flags[np.abs(seconds - wanted[:, None]).argmin(axis=1)] = True
    return BeatTrack(beats, flags, GRID)


def _peaks(logits: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the peaks above 0, in half frames; two peaks side by side are one between them."""
    largest = maximum_filter1d(logits, _WITHIN, mode="constant", cval=-np.inf)
    frames = np.flatnonzero((logits == largest) & (logits > 0)).tolist()
    peaks: list[int] = []
    nth = 0
    while nth < len(frames):
        pair = frames[nth + 1 : nth + 2] == [frames[nth] + 1]
        peaks.append(2 * frames[nth] + pair)
        nth += 1 + pair
    return np.asarray(peaks, dtype=np.int64)
