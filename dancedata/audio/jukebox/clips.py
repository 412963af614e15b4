"""Checks of clips and codes, the samples of a clip that the VQ-VAE encodes, and the frames that codes become."""

import math
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.kernel import resample

TooLong = Literal["error", "truncate"]
_MAX_CHANNELS = 64
# A truncated clip is encoded this far beyond its end: twice the reach of a code.
_MARGIN_S = 1


def prepare(samples: ArrayLike, sample_rate: int, config: JukeboxConfig) -> NDArray[np.float32]:
    """Average channels (m,) or (c, m), resample as librosa does, divide by the largest value; silence stays zero."""
    signal = np.asarray(samples)
    shaped = signal.ndim == 1 or (signal.ndim == 2 and 1 <= len(signal) <= _MAX_CHANNELS)
    if not (shaped and np.issubdtype(signal.dtype, np.floating)):
        raise UsageError("jukebox: invalid samples", found=f"{signal.dtype} of shape {signal.shape}",
                         allowed="floating-point samples, (m,) or (channels, m)")  # fmt: skip
    if sample_rate < 1:
        raise UsageError("jukebox: a sample rate must be above 0", found=sample_rate)
    mono = signal.astype(np.float32, copy=False)
    if mono.ndim == 2:
        mono = np.mean(mono, axis=0)
    if not mono.size:
        raise DataError("jukebox: the clip has no samples", reason="empty_audio", found="0 samples")
    bad = np.flatnonzero(~np.isfinite(mono))
    if bad.size:
        raise DataError("jukebox: the clip has samples that are not finite", reason="nan",
                        found=f"{bad.size} samples, the first at {bad[0] / sample_rate:.3f} s",
                        allowed="finite samples")  # fmt: skip
    audio = resample(np.ascontiguousarray(mono), sample_rate, config.sample_rate)
    require_audio(len(audio), config)
    peak = np.max(np.abs(audio))
    return audio / peak if peak > 0 else audio


def require_audio(n_samples: int, config: JukeboxConfig) -> None:
    """Raise DataError "short_audio" for fewer samples than one code."""
    if n_samples < config.hop:
        raise DataError("jukebox: the clip is too short", reason="short_audio",
                        found=f"{n_samples} samples at {config.sample_rate} Hz",
                        allowed=f"at least {config.hop} (one code)")  # fmt: skip


def require_length(n_codes: int, max_codes: int, config: JukeboxConfig) -> None:
    """Raise DataError "long_audio" for more codes than the network takes, or than its tables were loaded for."""
    if n_codes <= max_codes:
        return
    limit = f"{max_codes} codes ({max_codes / float(config.code_rate):.2f} s)"
    if max_codes < config.n_ctx:
        limit += f", as the encoder was loaded with max_codes={max_codes} of {config.n_ctx}"
    raise DataError(
        "jukebox: the clip is too long",
        reason="long_audio",
        found=f"{n_codes} codes ({n_codes / float(config.code_rate):.2f} s)",
        allowed=f"at most {limit}",
        fix='cut it into shorter clips, or pass too_long="truncate" to drop the rest, as the reference does',
    )


def fitted(audio: NDArray[np.float32], max_codes: int, config: JukeboxConfig, too_long: str) -> NDArray[np.float32]:
    """Return the part of a prepared clip that is encoded; DataError "long_audio" unless `too_long` is "truncate"."""
    if too_long not in ("error", "truncate"):
        raise UsageError("jukebox: invalid value for too_long", found=too_long,
                         fix=did_you_mean(too_long, ("error", "truncate")))  # fmt: skip
    if too_long == "error":
        require_length(len(audio) // config.hop, max_codes, config)
    return audio[: max_codes * config.hop + _MARGIN_S * config.sample_rate]


def require_max_codes(max_codes: int | None, config: JukeboxConfig) -> int:
    """Return the greatest length of clips in codes; None is the whole context."""
    longest = config.n_ctx if max_codes is None else max_codes
    if not 1 <= longest <= config.n_ctx:
        raise UsageError("jukebox: invalid value for max_codes", found=max_codes, allowed=f"1 to {config.n_ctx}")
    return longest


def require_codes(codes: ArrayLike, config: JukeboxConfig) -> NDArray[np.int64]:
    """Return one clip's codes as (n,) int64; UsageError for other arrays, DataError "short_audio" if empty."""
    array = np.asarray(codes)
    if array.ndim != 1 or not (np.issubdtype(array.dtype, np.integer) or not array.size):
        raise UsageError(
            "jukebox: invalid codes", found=f"{array.dtype} of shape {array.shape}", allowed="(n,) integers"
        )
    if not array.size:
        raise DataError("jukebox: the clip has no codes", reason="short_audio", found="0 codes")
    if array.min() < 0 or array.max() >= config.codebook_size:
        raise UsageError("jukebox: codes out of range", found=f"{array.min()} to {array.max()}",
                         allowed=f"0 to {config.codebook_size - 1}")  # fmt: skip
    return array.astype(np.int64, copy=False)


def n_frames(n_codes: int, fps: float | Fraction, code_rate: float | Fraction) -> int:
    """Return the number of frames of n_codes codes: ceil(n * fps / rate), in librosa's own floating point."""
    return math.ceil(n_codes * (float(fps) / float(code_rate)))


def resampling_matrix(n_in: int, n_out: int) -> NDArray[np.float32]:
    """Return the matrix R (n_out, n_in) of scipy.signal.resample along time, for x (n_in, D).

    It keeps the lowest n_out // 2 + 1 bins of the real Fourier transform and transforms back at the new length. The
    clip is treated as periodic, so its ends ring into each other, as in the reference's features.
    """
    shorter = min(n_in, n_out)
    k = np.arange(shorter // 2 + 1)
    # Bin k stands for +k and -k, except the last bin of an even length; scipy doubles it when downsampling.
    weight = np.where(k == 0, 1.0, 2.0)
    if shorter % 2 == 0 and n_out >= n_in:
        weight[-1] = 1.0
    # k m mod n before the division: exact phases, however long the clip.
    phase_out = 2 * np.pi * (np.outer(np.arange(n_out), k) % n_out) / n_out
    phase_in = 2 * np.pi * (np.outer(k, np.arange(n_in)) % n_in) / n_in
    matrix = (np.cos(phase_out) * weight) @ np.cos(phase_in) + (np.sin(phase_out) * weight) @ np.sin(phase_in)
    result: NDArray[np.float32] = (matrix / n_in).astype(np.float32)
    return result
