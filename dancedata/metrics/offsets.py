"""The offset of music against motion: rhythm curves of a dance, and the lag at which music fits them best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS
from dancedata.core.rotations import Float64Array
from dancedata.metrics.root import STEADY_FPS, steady

#: Rows of rhythm curves and of onsets per second.
RATE = 240
#: Columns of `rhythm_curves`.
CURVES = ("body", "hands", "root", "steps")
_HANDS = ("left_wrist", "right_wrist")
_FEET = (("left_ankle", "left_foot"), ("right_ankle", "right_foot"))
#: Widths of Gaussians, seconds: of speeds, of speeds of feet, of onsets, of the trend that is subtracted.
_SPEED_S, _FEET_S, _ONSET_S, _TREND_S = 0.03, 0.02, 0.01, 1.0
#: Feet slower than this are planted, and faster than the second one in the air, m/s.
_PLANTED_M_S, _SWUNG_M_S = 0.05, 1.0
#: Length of a segment, seconds, and the least number of them.
_SEGMENT_S, _LEAST_SEGMENTS = 1.0, 6
#: Draws of the null distribution, and resamplings of segments.
_DRAWS, _RESAMPLED = 299, 200
#: Stretches of songs of the null distribution, octaves: 4 to 52 %.
_STRETCH = (0.06, 0.6)
#: Ranges of beats, seconds; where it is not stated, the most likely one and the width of the prior, octaves.
_BEATS_S, _BEAT_S, _BEAT_OCTAVES = (0.3, 1.2), 0.5, 0.9
#: Peaks count as equal if 0 is within this interval of their difference; and the interval that is returned.
_EQUAL, _INTERVAL = 0.95, 0.9
#: Equal peaks that are nearer than this share of a beat contradict each other; farther ones are other beats.
_OTHER_BEAT = 0.75
#: Widest known offset, seconds: three quarters of a frame at 60 per second, which leaves room for a bias.
_MAX_WIDTH_S = 1 / 80

#: Why an offset is unknown.
REASONS = {
    "short": "less than 6 s of motion with music",
    "still": "the motion or the music has no rhythm",
    "p": "songs at other tempos fit as well",
    "edge": "the best fit is at the border of the window",
    "rivals": "other songs of the source fit too",
    "peaks": "two offsets within a beat fit equally well",
    "half_beat": "it is about half a beat or more: the beat before or after is as near",
    "wide": "its interval is more than 12.5 ms to each side",
}


@dataclass(frozen=True, eq=False)
class RhythmPiece:
    """A clip and its music."""

    curves: npt.NDArray[Any]  # (T, 4) `rhythm_curves`
    music: npt.NDArray[Any]  # (M,) `music_rhythm` of the whole song
    start_s: float = 0.0  # second of the song at the first row of the curves, as it is stated


@dataclass(frozen=True)
class Offset:
    """The offset of music against motion, or why it is unknown."""

    # Seconds to add to the second of the music at frame 0: positive if the dance is early, so that it is in step with
    # music that was played before it began. None without a peak; the best guess where `unknown` is set.
    offset_s: float | None = None
    width_s: float | None = None  # half of its 90 % interval, from resampled segments
    p: float | None = None  # share of songs at other tempos that fit at least as well at their best offset
    rivals: int = 0  # number of other songs, at their tempo, that fit with a `p` of at most the level at some offset
    fit: float | None = None  # correlation of the sum of rhythm curves with the onsets there
    beat_s: float | None = None  # seconds of a beat: the offset could as well be this much more or less
    unknown: str = ""  # a key of `REASONS`; "" if the offset is known
    # offset of each rhythm curve alone, within half a beat of `offset_s`
    curves: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0  # length of the motion


def rhythm_curves(joints: Float64Array, fps: float, names: Sequence[str]) -> npt.NDArray[np.float32]:
    """Return curves that are high where a dancer marks a beat.

    "body", "hands" and "root": minus the logarithm of the speed, a mean over joints, which peaks where they rest
    (kinematic beats; Kim et al. 2003, Rhythmic-motion synthesis based on motion-beat analysis; Davis and Agrawala
    2018, Visual rhythm and beat). "steps": how fast the logarithm of the speed of a foot falls, which peaks where it
    lands.

    `joints`: (T, J, 3) positions, metres.
    `names`: (J,) names of the joints, SMPL's among them.
    Returns: At second t / `RATE`; columns `CURVES`.
    """
    body = [names.index(name) for name in BODY_JOINTS if name in names]
    places = steady(joints[:, body], fps)
    if len(places) < 2:
        return np.zeros((len(places), len(CURVES)), np.float32)
    steps = np.diff(places, axis=0)
    speed = np.sqrt((steps * steps).sum(axis=2)) * STEADY_FPS
    column = {names[joint]: k for k, joint in enumerate(body)}
    landing = np.zeros(len(speed))
    for foot in _FEET:
        of_foot = _smooth(speed[:, [column[name] for name in foot]].mean(axis=1), _FEET_S * STEADY_FPS)
        landing += np.maximum(-np.gradient(np.log(of_foot.clip(_PLANTED_M_S, _SWUNG_M_S))), 0)
    hands = speed[:, [column[name] for name in _HANDS]].mean(axis=1)
    curves = np.stack([_rest(speed.mean(axis=1)), _rest(hands), _rest(speed[:, 0]), landing], axis=1)
    # Value t is the step from t to t + 1.
    instants = (np.arange(len(speed)) + 0.5) / STEADY_FPS
    rows = np.arange((len(places) - 1) * RATE // STEADY_FPS + 1) / RATE
    return np.stack([np.interp(rows, instants, curve) for curve in curves.T], axis=1).astype(np.float32)


def music_rhythm(onsets: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return the sum (M,) float32 of onset strengths (M, B), `RATE` rows per second, in bands of equal weight.

    Each band without its trend, divided by its standard deviation; smoothed by a Gaussian of 10 ms.
    """
    total = _sum(onsets)
    return _standard(_smooth(total, _ONSET_S * RATE)[:, np.newaxis])[:, 0].astype(np.float32)


def find_offset(
    pieces: Sequence[RhythmPiece],
    others: Sequence[npt.NDArray[Any]] = (),
    *,
    window_s: float = 0.5,
    level: float = 0.02,
    tempo_bpm: float | None = None,
    test_songs: bool = False,
    seed: int = 0,
) -> Offset:
    """Find the offset that clips have in common.

    The fit at a lag is the correlation of the sum of rhythm curves, each with its trend subtracted and divided by its
    standard deviation, with the music's. Its peaks within the window repeat with the beat. Those that
    do not differ from the highest (95 % interval of paired differences, from resampled segments of 1 s and Student's
    t) count as equal, and the nearest to 0 is taken.

    `p` is the rank of the highest fit among 299 draws of a null distribution: a random song of `others` or the
    clip's own, from a random second on, 4 to 52 % faster or slower, at its best lag in the window. So it tests
    whether motion and music share a rhythm. Another song of the same tempo fits as well, at some offset: such songs
    are counted.

    `pieces`: Clips of one recording or song.
    `others`: (M,) `music_rhythm` of other songs.
    `window_s`: Offsets from minus this to this are searched.
    `level`: Largest `p` of a known offset.
    `tempo_bpm`: Of the music; None: from its onsets.
    `test_songs`: The offset is unknown too if other songs fit.
    """
    reach = round(window_s * RATE)
    seconds = sum(len(piece.curves) for piece in pieces) / RATE
    songs = [np.asarray(piece.music, dtype=np.float64) for piece in pieces]
    sections = [_section(piece, song, reach) for piece, song in zip(pieces, songs, strict=True)]
    motions = [_sum(piece.curves) for piece in pieces]
    fits = np.array([row for m, a in zip(motions, sections, strict=True) for row in _segments(m, a, reach)])
    if len(fits) < _LEAST_SEGMENTS:
        return Offset(unknown="short", seconds=seconds)
    norm = _norm(motions, sections)
    if not norm > 0:
        return Offset(unknown="still", seconds=seconds)
    rng = np.random.Generator(np.random.PCG64(seed))
    drawn = rng.integers(len(fits), size=(_RESAMPLED, len(fits)))
    total, resampled = fits.sum(axis=0), np.stack([fits[numbers].sum(axis=0) for numbers in drawn])
    own = next(song for song in songs if song.any())
    beat = round((60 / tempo_bpm if tempo_bpm else _beat_s(own)) * RATE)
    foreign = [np.asarray(other, dtype=np.float64) for other in others]
    null = _null(motions, pieces, [own, *(song for song in foreign if song.any())], reach, rng)
    p = _rank(total.max() / norm, null)
    rivals = sum(_rank(_highest(motions, pieces, song, reach), null) <= level for song in foreign)
    lag, unknown = _choose(total, resampled, reach, beat, _errors(len(fits), _EQUAL))
    near = slice(max(0, lag - beat // 2), lag + beat // 2 + 1)
    places = np.array([_vertex(row, near) for row in resampled])
    width_s = float(places.std()) * _errors(len(fits), _INTERVAL) / RATE
    if p > level:
        unknown = "p"
    elif rivals and test_songs:
        unknown = "rivals"
    elif not unknown and width_s > _MAX_WIDTH_S:
        unknown = "wide"
    curves = {}
    for k, name in enumerate(CURVES):
        alone = [_sum(piece.curves[:, [k]]) for piece in pieces]
        curves[name] = (_vertex(_fits(alone, sections, reach), near) - reach) / RATE
    return Offset(
        offset_s=(_vertex(total, near) - reach) / RATE, width_s=width_s, p=p, rivals=rivals,
        fit=float(total[lag] / norm), beat_s=beat / RATE, unknown=unknown, curves=curves, seconds=seconds,
    )  # fmt: skip


def _smooth(curve: Float64Array, sigma: float) -> Float64Array:
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(curve, sigma, axis=0), dtype=np.float64)


def _rest(speed: Float64Array) -> Float64Array:
    smooth = _smooth(speed, _SPEED_S * STEADY_FPS)
    return np.asarray(-np.log(smooth + 0.05 * smooth.mean() + 1e-3))


def _sum(curves: npt.NDArray[Any]) -> Float64Array:
    """Return the sum (T,) of curves (T, K) without their trends, all with the same standard deviation, as the sum."""
    return _standard(_standard(np.asarray(curves, dtype=np.float64)).sum(axis=1, keepdims=True))[:, 0]


def _standard(curves: Float64Array) -> Float64Array:
    level = curves - _smooth(curves, _TREND_S * RATE) if len(curves) else curves
    spread = level.std(axis=0) if len(curves) else np.zeros(curves.shape[1])
    return np.asarray(level / np.where(spread > 1e-9, spread, np.inf))


def _section(piece: RhythmPiece, song: Float64Array, reach: int) -> Float64Array:
    """Return the song (T + 2 reach,) around a clip; 0 where there is none."""
    rows = np.arange(-reach, len(piece.curves) + reach) + round(piece.start_s * RATE)
    inside = (rows >= 0) & (rows < len(song))
    section = np.zeros(len(rows))
    section[inside] = song[rows[inside]]
    return section


def _fit(motion: Float64Array, section: Float64Array, reach: int) -> Float64Array:
    """Return the sums (2 reach + 1,) of products of a motion (T,) with a song (T + 2 reach,), by lag."""
    size = 1 << (len(section) - 1).bit_length()
    spectrum = np.fft.rfft(section, size) * np.conj(np.fft.rfft(motion, size))
    return np.asarray(np.fft.irfft(spectrum, size)[: 2 * reach + 1])


def _fits(motions: Sequence[Float64Array], sections: Sequence[Float64Array], reach: int) -> Float64Array:
    return np.asarray(np.sum([_fit(m, a, reach) for m, a in zip(motions, sections, strict=True)], axis=0))


def _segments(motion: Float64Array, section: Float64Array, reach: int) -> list[Float64Array]:
    """Return the sums of each segment with music; the last one is longer."""
    length = round(_SEGMENT_S * RATE)
    starts = [k * length for k in range(len(motion) // length)]
    ends = [*starts[1:], len(motion)]
    return [
        _fit(motion[a:b], section[a : b + 2 * reach], reach)
        for a, b in zip(starts, ends, strict=False)
        if section[a + reach : b + reach].any()
    ]


def _norm(motions: Sequence[Float64Array], sections: Sequence[Float64Array]) -> float:
    return math.sqrt(sum(float((m * m).sum()) for m in motions) * sum(float((a * a).sum()) for a in sections))


def _beat_s(song: Float64Array) -> float:
    """Return the beat of a song: the peak of its autocorrelation, weighted around 0.5 s (Ellis 2007)."""
    size = 1 << (2 * len(song) - 1).bit_length()
    power = np.fft.rfft(song, size)
    lags = np.arange(round(_BEATS_S[0] * RATE), round(_BEATS_S[1] * RATE))
    likeness = np.fft.irfft(power.real**2 + power.imag**2, size)[lags]
    prior = np.exp(-0.5 * (np.log2(lags / RATE / _BEAT_S) / _BEAT_OCTAVES) ** 2)
    return float(lags[np.argmax(likeness * prior)] / RATE)


def _null(
    motions: Sequence[Float64Array], pieces: Sequence[RhythmPiece], songs: Sequence[Float64Array], reach: int,
    rng: np.random.Generator,
) -> Float64Array:  # fmt: skip
    """Return the highest fits of songs at other tempos, for each draw."""
    highest = np.zeros(_DRAWS)
    rings = [(np.arange(len(song) + 1), np.append(song, song[:1])) for song in songs]
    longest = max(map(len, motions)) + 2 * reach
    size = 1 << (longest - 1).bit_length()
    conjugates = [np.conj(np.fft.rfft(m, size)) for m in motions]
    for draw in range(_DRAWS):
        ring = rings[int(rng.integers(len(songs)))]
        length = len(ring[0]) - 1
        speed = 2.0 ** (rng.uniform(*_STRETCH) * (1 if rng.random() < 0.5 else -1))
        begin = rng.uniform(0, length)
        total, sections = np.zeros(2 * reach + 1), []
        for motion, piece, conjugate in zip(motions, pieces, conjugates, strict=True):
            rows = begin + (np.arange(-reach, len(motion) + reach) + piece.start_s * RATE) * speed
            section = np.interp(rows % length, *ring)
            total += np.fft.irfft(np.fft.rfft(section, size) * conjugate, size)[: 2 * reach + 1]
            sections.append(section)
        norm = _norm(motions, sections)
        highest[draw] = total.max() / norm if norm > 0 else 0.0
    return highest


def _rank(fit: float, null: Float64Array) -> float:
    return (1 + int((null >= fit).sum())) / (1 + len(null))


def _highest(motions: Sequence[Float64Array], pieces: Sequence[RhythmPiece], song: Float64Array, reach: int) -> float:
    """Return the highest fit of another song; 0 where it is silent."""
    sections = [_section(piece, song, reach) for piece in pieces]
    norm = _norm(motions, sections)
    return float(_fits(motions, sections, reach).max() / norm) if norm > 0 else 0.0


def _errors(n: int, share: float) -> float:
    """Return half an interval in standard deviations of a sum of `n` resampled segments, which are few."""
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 0.5 + share / 2)) * math.sqrt(n / (n - 1))


def _choose(total: Float64Array, resampled: Float64Array, reach: int, beat: int, errors: float) -> tuple[int, str]:
    """Return the lag, a row of `total`, and why it is unknown, "" if not."""
    inner = total[1:-1]
    peaks = np.flatnonzero((inner > total[:-2]) & (inner >= total[2:])) + 1
    if not len(peaks):
        return int(total.argmax()), "edge"
    best = int(peaks[total[peaks].argmax()])
    at_edge = total.max() > total[best]
    differences = resampled[:, [best]] - resampled[:, peaks]
    equal = peaks[total[best] - total[peaks] <= errors * differences.std(axis=0)]
    by_distance = equal[np.argsort(np.abs(equal - reach), kind="stable")]
    lag, rest = int(by_distance[0]), by_distance[1:]
    if np.any(np.abs(rest - lag) < _OTHER_BEAT * beat):
        return lag, "peaks"
    if at_edge and min(lag, 2 * reach - lag) < _OTHER_BEAT * beat:
        return lag, "edge"
    if abs(lag - reach) > 0.45 * beat:
        return lag, "half_beat"
    return lag, ""


def _vertex(total: Float64Array, near: slice) -> float:
    """Return the place of the highest value within rows, at the vertex of a parabola."""
    place = near.start + int(total[near].argmax())
    if not 0 < place < len(total) - 1:
        return float(place)
    before, here, after = (float(v) for v in total[place - 1 : place + 2])
    bend = before - 2 * here + after
    return float(place + (0.5 * (before - after) / bend if bend < 0 else 0.0))
