"""The fast version of librosa35: what the windows of a song have in common is computed once.

The numbers are those of `reference`, up to float32 rounding; docs/archive/decisions.md explains why. Nothing here
needs librosa or numba, whose import takes seconds in every process.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP, N_COLUMNS, TEMPO_SAMPLE_RATE, Settings, log_once
from dancedata.audio.librosa35.arrays import Floats, one_blas_thread, strided
from dancedata.audio.librosa35.beats import window_beats, window_tempos
from dancedata.audio.librosa35.chroma import STEPS, cens, shares_of, window_chroma
from dancedata.audio.librosa35.filters import N_OCTAVES, filter_bank, has_one_bank, sparse_filters
from dancedata.audio.librosa35.resample import MAX_PERIOD, halved, period
from dancedata.audio.librosa35.spectra import (
    LAG,
    N_FFT,
    TOP_DB,
    envelope_and_mfcc,
    hann,
    mel_db,
    mel_filters,
    onset_margins,
    onset_peaks,
    window_spectra,
)
from dancedata.audio.librosa35.tuning import BINS_PER_OCTAVE, Peaks, find_peaks, window_tuning
from dancedata.audio.librosa35.windows import Windows, resampled_windows, shortest
from dancedata.core.audio_signal import pcm16, resampled_length
from dancedata.kernel import resample

# Largest difference of a share, where a frame is loud (seen: 3.3e-7), and as a part of the window's largest sample
# over the frame's loudness (seen: 2.4e-5): a loud sound without pitch, such as an offset or a tone below the lowest
# filter, is rounded as any other sound is.
_ROUNDING, _NOISE = 4e-7, 3e-5
# Largest difference of an envelope, in dB; seen: 1.1e-4, where all bands but one are 50 to 80 dB below it.
_ENVELOPE_ERROR = 3e-4
_FRAMES_AT_ONCE = 64


def near_ties(chroma: Floats, largest: Floats) -> NDArray[np.bool_]:
    """Return in which frames of chroma (W, T, 12) a share is within rounding of a step; (W, T)."""
    loudness = chroma.sum(axis=2)
    relative = largest[:, np.newaxis] / np.maximum(loudness, np.finfo(np.float32).tiny)
    tolerance = np.maximum(_ROUNDING, _NOISE * relative)
    near = np.zeros(loudness.shape, dtype=np.bool_)
    shares = shares_of(chroma)
    for step in STEPS:
        near |= (np.abs(shares - np.float32(step)) < tolerance[..., np.newaxis]).any(axis=2)
    # Magnitudes too small to be squared count as zero here, and all frames of a silent window do.
    return np.asarray(near & (largest > 0)[:, np.newaxis])


def _decided_onsets(envelope: Floats, rate: int, samples_of: Callable[[int], Floats]) -> NDArray[np.bool_]:
    """Return which frames of envelopes (W, T) are onsets; where rounding matters, librosa's envelope decides."""
    peaks = onset_peaks(envelope, rate)
    for window in np.flatnonzero(onset_margins(envelope, rate) < _ENVELOPE_ERROR).tolist():
        peaks[window] = onset_peaks(librosa_envelope(samples_of(window), rate)[np.newaxis], rate)[0]
    return peaks


def librosa_envelope(samples: Floats, rate: int) -> Floats:
    """Return librosa's `onset_strength` (T,) of a signal (n,)."""
    power = np.concatenate([np.abs(spectrum) ** 2.0 for spectrum in _librosa_spectra(samples)])
    mel = np.einsum("...ft,mf->...mt", power.T, mel_filters(rate).T, optimize=True)
    db = 10.0 * np.log10(np.maximum(1e-10, mel))
    db = np.maximum(db, db.max() - TOP_DB)
    envelope = np.zeros(db.shape[1], dtype=np.float32)
    envelope[LAG:] = np.maximum(0.0, db[:, 1:] - db[:, :-1]).mean(axis=0)[: len(envelope) - LAG]
    return envelope


def decide_near_ties(
    chroma: Floats, largest: Floats, tunings: Sequence[int], rate: int, samples_of: Callable[[int], Floats]
) -> None:
    """Replace frames of chroma (W, T, 12) in which a share is too close to a step by librosa's."""
    near = near_ties(chroma, largest)
    for window in np.flatnonzero(near.any(axis=1)).tolist():
        frames = np.flatnonzero(near[window])
        chroma[window, frames] = _librosa_chroma(samples_of(window), frames, tunings[window], rate)


def _librosa_chroma(samples: Floats, frames: NDArray[np.int64], tuning: int, rate: int) -> Floats:
    """Return librosa's `chroma_cqt` (F, 12), not normalised, of frames (F,) of a signal (n,)."""
    filters, lengths = sparse_filters(tuning, rate)
    magnitudes = np.zeros((N_OCTAVES * BINS_PER_OCTAVE, 1 + len(samples) // HOP), dtype=np.float32, order="F")
    for octave in range(N_OCTAVES):
        samples = halved(samples) if octave else samples
        response = _response(samples, frames * (HOP >> octave), filters, 2.0**octave)
        bins = slice((N_OCTAVES - 1 - octave) * BINS_PER_OCTAVE, (N_OCTAVES - octave) * BINS_PER_OCTAVE)
        response /= np.sqrt(lengths[bins, np.newaxis])
        magnitudes[bins, frames] = np.abs(response)
    to_chroma = np.roll(np.repeat(np.eye(12, dtype=np.float32), 3, axis=1), -1, axis=1)
    chroma = np.einsum("cf,...ft->...ct", np.tile(to_chroma, N_OCTAVES), magnitudes, optimize=True)
    return np.asarray(chroma[:, frames].T)


def _librosa_tuning(samples: Floats, rate: int) -> int:
    """Return librosa's `estimate_tuning` of a signal (n,), as the index of the histogram's bar."""
    peaks = [find_peaks(np.abs(spectrum), rate, is_power=False) for spectrum in _librosa_spectra(samples)]
    return window_tuning(Peaks.concatenated(peaks), np.arange(1 + len(samples) // HOP))[0]


def _librosa_spectra(samples: Floats) -> Iterator[NDArray[np.complex64]]:
    """Yield librosa's `stft` of a signal (n,), several frames at a time, (F, 1025) each."""
    import scipy.fft

    n_frames = 1 + len(samples) // HOP
    padded = np.pad(samples, (N_FFT // 2, N_FFT))
    frames = strided(padded, (n_frames, N_FFT), (HOP, 1))
    window = hann(N_FFT)
    for first in range(0, n_frames, _FRAMES_AT_ONCE):
        yield scipy.fft.rfft(frames[first : first + _FRAMES_AT_ONCE] * window, axis=1).astype(np.complex64)


def _response(samples: Floats, centres: NDArray[np.int64], filters: Any, decimation: float) -> NDArray[np.complex64]:
    """Return the responses (36, F) of filters to frames around samples `centres` (F,)."""
    import scipy.fft

    n_fft = 2 * (filters.shape[1] - 1)
    padded = np.pad(samples, (n_fft // 2, n_fft))
    frames = padded[centres + np.arange(n_fft)[:, np.newaxis]].astype(np.float64)
    spectra = scipy.fft.rfft(frames, axis=0).astype(np.complex64)
    scaled = filters.copy()
    scaled.data *= np.sqrt(np.float64(decimation))
    response: NDArray[np.complex64] = scaled.dot(spectra)
    return response


_TEMPO_START_BPM = 120.0
# With fewer rows every frame touches an end of the signal; the reference is fast enough for them.
_MIN_ROWS = 16
_MIN_PEAK, _MAX_PEAK = 1e-6, 1e6
# A window with a passage this far below the track's peak (-80 dB) is computed by itself: resampling the track
# leaves rounding noise there (1e-8 of the loud samples nearby), and chroma are scaled to unit length.
_QUIET = 1e-4
_PIECE = 1 << 14
# Longer tiles save more at their borders and take more memory.
_TILE_S = 64


def why_not_windows(n_samples: int, sample_rate: int, rate: int) -> str:
    """Return why this version cannot compute windows of `n_samples`; empty if it can. The reference always can."""
    if not has_one_bank(rate):
        return f"at {rate / HOP:g} frames per second librosa's constant-Q filters differ between octaves"
    is_short = resampled_length(n_samples, sample_rate, rate) < HOP * _MIN_ROWS
    return f"it needs more than {_MIN_ROWS} rows" if is_short else ""


def why_not_shared(sample_rate: int, rate: int) -> str:
    """Return why windows at this sample rate share no work and take three times as long; empty if they do share."""
    samples = period(sample_rate, rate)
    if samples <= MAX_PERIOD:
        return ""
    return f"samples at {sample_rate} Hz and at {rate} Hz coincide only every {samples}, more than {MAX_PERIOD}"


def track_obstacle(samples: Floats, sample_rate: int, rate: int) -> str:
    """Return why this version cannot compute a signal: as for windows, or squares beyond single precision."""
    reason = why_not_windows(len(samples), sample_rate, rate)
    if reason:
        return reason
    peak = float(np.abs(samples).max())
    is_usual = peak == 0 or _MIN_PEAK <= peak <= _MAX_PEAK
    return "" if is_usual else f"the largest sample is not within {_MIN_PEAK:g} .. {_MAX_PEAK:g}"


def track_features(samples: Floats, settings: Settings) -> Floats:
    """Compute the features (T, 35) of a whole signal (n,)."""
    bpm = settings.start_bpm
    with one_blas_thread():
        if bpm is None:
            bpm = estimated_bpm(samples, settings.sample_rate)
        windows = Windows.whole(resample(samples, settings.sample_rate, settings.rate))
        features: Floats = _features(windows, [bpm], settings, lambda _: windows.track)[0]
    return features


def window_features(samples: Floats, starts: NDArray[np.int64], n_samples: int, settings: Settings) -> Floats:
    """Compute the features (W, T, 35) of windows of a signal, each as if it were a separate 16-bit wav.

    Windows that begin a whole number of frames after the signal does share work, unless `why_not_shared`; others are
    computed by themselves, at a third of the speed.
    """
    sample_rate, rate = settings.sample_rate, settings.rate
    if reason := why_not_shared(sample_rate, rate):
        log_once("librosa35: windows are computed one by one, three times as slowly: %s", reason)
    n_rows = 1 + resampled_length(n_samples, sample_rate, rate) // HOP
    features = np.empty((len(starts), n_rows, N_COLUMNS), dtype=np.float32)
    alone = np.ones(len(starts), dtype=np.bool_)
    for members, tile in _tiles(starts, n_samples, sample_rate, rate):
        quantised = _pcm16(samples[tile : tile + _tile_length(sample_rate, rate) + n_samples])
        with one_blas_thread():
            loud, rows = _tile_features(quantised, starts[members] - tile, n_samples, settings)
        features[members[loud]] = rows
        alone[members[loud]] = False
    for k in np.flatnonzero(alone):
        window = pcm16(samples[starts[k] : starts[k] + n_samples])
        features[k] = track_features(window, settings)
    return features


def _tile_features(
    samples: Floats, starts: NDArray[np.int64], n_samples: int, settings: Settings
) -> tuple[NDArray[np.int64], Floats]:
    """Compute the windows of a tile that have no quiet passage: their indices (V,) and features (V, T, 35)."""
    sample_rate, rate = settings.sample_rate, settings.rate
    windows = resampled_windows(samples, starts, n_samples, sample_rate, rate)
    loud = np.flatnonzero(~_is_quiet(windows))
    if not len(loud):
        return loud, np.empty((0, 1 + windows.length // HOP, N_COLUMNS), dtype=np.float32)
    parts = [samples[start : start + n_samples] for start in starts[loud]]
    bpms = [settings.start_bpm or estimated_bpm(window, sample_rate) for window in parts]
    return loud, _features(windows.some(loud), bpms, settings, lambda k: resample(parts[k], sample_rate, rate))


def estimated_bpm(samples: Floats, sample_rate: int) -> float:
    """Estimate a tempo from a signal alone, as `librosa.feature.tempo` of the audio at 22,050 Hz does."""
    db = mel_db(resample(samples, sample_rate, TEMPO_SAMPLE_RATE), TEMPO_SAMPLE_RATE)
    envelope, _ = envelope_and_mfcc(db, np.arange(len(db))[np.newaxis])
    return float(window_tempos(envelope, TEMPO_SAMPLE_RATE, _TEMPO_START_BPM)[0])


def _features(
    windows: Windows, bpms: Sequence[float], settings: Settings, samples_of: Callable[[int], Floats]
) -> Floats:
    """Compute the features (W, T, 35) of windows at the features' rate that begin on multiples of 512 samples."""
    rate = settings.rate
    spectra = window_spectra(windows, rate)
    envelope, mfcc = envelope_and_mfcc(spectra.db, spectra.rows)
    tunings = []
    for window, rows in enumerate(spectra.rows):
        tuning, is_certain = window_tuning(spectra.peaks, rows)
        tunings.append(tuning if is_certain else _librosa_tuning(samples_of(window), rate))
    tempos = np.empty(len(bpms))
    for bpm in set(bpms):
        same = np.flatnonzero(np.asarray(bpms) == bpm)
        tempos[same] = window_tempos(envelope[same], rate, bpm)
    chroma = window_chroma(windows, tunings, rate)
    decide_near_ties(chroma, windows.largest(), tunings, rate, samples_of)
    features = np.empty((*envelope.shape, N_COLUMNS), dtype=np.float32)
    features[..., 0] = envelope
    features[..., 1:21] = mfcc
    features[..., 21:33] = cens(chroma)
    features[..., 33] = _decided_onsets(envelope, rate, samples_of)
    features[..., 34] = window_beats(envelope, tempos, rate, settings.tightness)
    return features


def _tiles(
    starts: NDArray[np.int64], n_samples: int, sample_rate: int, rate: int
) -> Iterator[tuple[NDArray[np.int64], int]]:
    """Yield the indices of windows that share work, with the first sample of their tile of the signal.

    The places of the tiles do not depend on the windows, so that the numbers of a window do not depend on the others.
    """
    half = len(filter_bank(0, rate).even)
    if n_samples < shortest(sample_rate, rate, N_OCTAVES - 1, half) or why_not_shared(sample_rate, rate):
        return
    in_time = np.argsort(starts, kind="stable")
    on_frames = in_time[starts[in_time] * rate % (HOP * sample_rate) == 0]
    length = _tile_length(sample_rate, rate)
    for tile in np.unique(starts[on_frames] // length):
        yield on_frames[starts[on_frames] // length == tile], int(tile) * length


def _tile_length(sample_rate: int, rate: int) -> int:
    """Return the samples of a tile: about a minute, a whole number of frames and of samples at both rates."""
    unit = HOP * sample_rate // math.gcd(HOP * sample_rate, rate)
    return max(1, _TILE_S * sample_rate // unit) * unit


def _pcm16(samples: Floats) -> Floats:
    """Quantise as `pcm16` does, piece by piece: the pieces stay in the processor's cache."""
    quantised = np.empty_like(samples)
    for start in range(0, len(samples), _PIECE):
        quantised[start : start + _PIECE] = pcm16(samples[start : start + _PIECE])
    return quantised


def _is_quiet(windows: Windows) -> NDArray[np.bool_]:
    """Return for each window whether the track has a quiet passage in it, (W,)."""
    n_blocks = windows.length // HOP
    whole = windows.track[: len(windows.track) // HOP * HOP].reshape(-1, HOP)
    loudest = np.abs(whole).max(axis=1)
    blocks = windows.starts[:, np.newaxis] // HOP + np.arange(n_blocks)
    quiet: NDArray[np.bool_] = (loudest[blocks] < _QUIET * loudest.max()).any(axis=1)
    return quiet
