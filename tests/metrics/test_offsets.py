"""The offset of music against motion: planted ones, other songs, each reason why one is unknown."""

from functools import cache

import numpy as np
import pytest

from dancedata.alignment.onsets import onset_strength
from dancedata.metrics import offsets
from dancedata.metrics.offsets import CURVES, RATE, Offset, RhythmPiece, find_offset, rhythm_curves
from dancedata.synthetic import synthesise_motion, synthesise_song

CLIPS = ("gBR_sBM_cAll_d04_mBR0_ch03", "gHO_sFM_cAll_d19_mHO3_ch01", "gPO_sBM_cAll_d10_mPO4_ch03")
SONGS = ("BR0", "HO3", "PO4", "LO2", "JS1", "WA3")
FRAME_S = 1 / 60


@cache
def song(music: str) -> np.ndarray:
    signal = synthesise_song(music, length_s=15, sample_rate=24_000, n_channels=1).signal
    return offsets.music_rhythm(onset_strength(signal, RATE))


@cache
def dance(clip: str, seconds: int = 14) -> np.ndarray:
    motion = synthesise_motion(clip, n_frames=60 * seconds)[0]
    return rhythm_curves(motion.joints(), 60, motion.skeleton.joints)


def others(music: str) -> list[np.ndarray]:
    return [song(name) for name in SONGS if name != music]


def late(rows: np.ndarray, ms: int) -> np.ndarray:
    """Return music that begins `ms` later in its file."""
    n = round(ms * RATE / 1000)
    return np.concatenate([np.zeros(n, rows.dtype), rows]) if n >= 0 else rows[-n:]


@pytest.mark.parametrize("ms", [-80, 0, 200])
@pytest.mark.parametrize("clip", CLIPS)
def test_planted_offsets_are_found_within_a_frame(clip: str, ms: int) -> None:
    music = clip.split("_m")[1][:3]
    found = find_offset([RhythmPiece(dance(clip), late(song(music), ms))], others(music), seed=1)
    assert not found.unknown
    assert found.offset_s == pytest.approx(round(ms * RATE / 1000) / RATE, abs=FRAME_S)
    assert found.p is not None
    assert found.width_s is not None
    assert found.p <= 0.02
    assert 0 < found.width_s < FRAME_S
    assert set(found.curves) == set(CURVES)


def test_the_stated_second_of_the_music_is_where_the_search_begins() -> None:
    music = song("BR0")
    half = dance(CLIPS[0])[4 * RATE // 2 :]
    found = find_offset([RhythmPiece(half, late(music, 100), 2.0)], others("BR0"), seed=1)
    assert found.offset_s == pytest.approx(0.1, abs=FRAME_S)


@pytest.mark.parametrize("clip", CLIPS)
def test_songs_of_another_tempo_give_no_offset(clip: str) -> None:
    own = clip.split("_m")[1][:3]
    for music in ("LO2", "JS1", "WA3"):
        found = find_offset([RhythmPiece(dance(clip), song(music))], others(music), seed=1)
        assert found.unknown == "p", (music, found)
        assert found.rivals <= 1, own


def test_a_song_of_the_same_tempo_is_a_rival() -> None:
    clip, copy = CLIPS[2], late(song("PO4"), 170)
    found = find_offset([RhythmPiece(dance(clip), song("PO4"))], [*others("PO4"), copy], seed=1)
    assert (found.unknown, found.rivals) == ("", 1)
    tested = find_offset([RhythmPiece(dance(clip), song("PO4"))], [*others("PO4"), copy], seed=1, test_songs=True)
    assert (tested.unknown, tested.offset_s) == ("rivals", found.offset_s)


def test_clips_together_are_the_sum_of_their_fits() -> None:
    """Against a plain loop over lags, with the clips' own normalisation."""
    pieces = [RhythmPiece(dance(clip), late(song("BR0"), 60)) for clip in (CLIPS[0], "gBR_sBM_cAll_d05_mBR0_ch04")]
    found = find_offset(pieces, others("BR0"), seed=1)
    reach = RATE // 2
    total = np.zeros(2 * reach + 1)
    squares = np.zeros(2)
    for piece in pieces:
        motion = offsets._sum(piece.curves)
        padded = np.concatenate([np.zeros(reach), piece.music.astype(np.float64), np.zeros(reach)])
        section = padded[: len(motion) + 2 * reach]
        squares += [(motion**2).sum(), (section**2).sum()]
        for lag in range(2 * reach + 1):
            total[lag] += (motion * section[lag : lag + len(motion)]).sum()
    best = int(total.argmax())
    assert found.offset_s == pytest.approx((best - reach) / RATE, abs=0.5 / RATE)
    assert found.fit == pytest.approx(total[best] / np.sqrt(squares.prod()), rel=1e-9)
    alone = [find_offset([piece], others("BR0"), seed=1) for piece in pieces]
    assert found.seconds == pytest.approx(sum(one.seconds for one in alone))


def test_short_and_still_clips_are_unknown() -> None:
    short = find_offset([RhythmPiece(dance(CLIPS[0])[: 5 * RATE], song("BR0"))])
    assert (short.unknown, short.offset_s, short.p) == ("short", None, None)
    without = find_offset([RhythmPiece(dance(CLIPS[0]), song("BR0"), start_s=60.0)])
    assert without.unknown == "short"
    still = np.zeros_like(dance(CLIPS[0]))
    assert find_offset([RhythmPiece(still, song("BR0"))]).unknown == "still"


def pulses(times: np.ndarray, seconds: float) -> np.ndarray:
    t = np.arange(round(seconds * RATE)) / RATE
    return np.exp(-0.5 * ((t[:, np.newaxis] - times) / 0.03) ** 2).sum(axis=1)


def artificial(
    offset: float, *, beat: float = 0.5, jitter: float = 0.0, every: float = 0.0, **options: float
) -> Offset:
    """A dance of pulses on each beat, and music whose beats are `offset` later; `every` puts others between."""
    rng = np.random.default_rng(2)
    beats = np.arange(1, 60) * beat
    heard = beats + offset
    heard = np.sort(np.concatenate([heard, heard + every])) if every else heard
    curves = np.repeat(pulses(beats + jitter * rng.standard_normal(len(beats)), 20)[:, np.newaxis], 4, axis=1)
    music = offsets.music_rhythm(pulses(heard, 24)[:, np.newaxis])
    return find_offset([RhythmPiece(curves, music)], tempo_bpm=60 / beat, seed=1, **options)  # type: ignore[arg-type]


def test_of_equal_peaks_the_nearest_to_zero_is_taken() -> None:
    found = artificial(0.12, beat=0.4)
    assert (found.unknown, round(found.offset_s or 0, 3)) == ("", 0.12)
    found = artificial(0.28, beat=0.4)
    assert (found.unknown, round(found.offset_s or 0, 3)) == ("", -0.12)


def test_half_a_beat_and_two_peaks_within_one_are_unknown() -> None:
    assert artificial(0.245, beat=0.5).unknown == "half_beat"
    assert artificial(0.20, beat=0.5).unknown == ""
    assert artificial(0.05, beat=0.8, every=0.3).unknown == "peaks"
    # The flank of a peak at 0.13 s rises up to the border of the window.
    assert artificial(0.13, beat=1.0, window_s=0.1).unknown == "edge"


def test_the_best_fit_beyond_the_window_is_unknown_though_a_lower_one_is_within() -> None:
    beats = np.arange(1.0, 20.0)
    curves = np.repeat(pulses(beats, 20)[:, np.newaxis], 4, axis=1)
    heard = pulses(beats + 0.33, 24) + 0.5 * pulses(beats - 0.1, 24)
    music = offsets.music_rhythm(heard[:, np.newaxis])
    assert find_offset([RhythmPiece(curves, music)], window_s=0.3, tempo_bpm=60).unknown == "edge"
    assert find_offset([RhythmPiece(curves, music)], window_s=0.4, tempo_bpm=60).unknown == ""


def test_a_loose_dance_has_a_wider_interval() -> None:
    tight, loose = artificial(0.05, jitter=0.005), artificial(0.05, jitter=0.09)
    assert tight.width_s is not None
    assert loose.width_s is not None
    assert loose.width_s > 4 * tight.width_s
    assert (tight.unknown, loose.unknown) == ("", "wide")


def test_curves_hardly_depend_on_the_frame_rate() -> None:
    motion = synthesise_motion(CLIPS[0], n_frames=601)[0]
    joints = motion.joints()
    at_60 = rhythm_curves(joints, 60, motion.skeleton.joints)
    at_30 = rhythm_curves(joints[::2], 30, motion.skeleton.joints)
    assert at_60.shape == at_30.shape == (2401, 4)
    likeness = [np.corrcoef(at_60[:, k], at_30[:, k])[0, 1] for k in range(4)]
    assert min(likeness) > 0.9
    found = find_offset([RhythmPiece(at_30, late(song("BR0"), 80))], others("BR0"), seed=1)
    assert found.offset_s == pytest.approx(0.08, abs=FRAME_S)


def test_a_body_with_fingers_has_the_same_curves() -> None:
    motion = synthesise_motion(CLIPS[0], n_frames=120)[0]
    names = (*motion.skeleton.joints[:22], "left_index1", "right_index1")
    rng = np.random.default_rng(0)
    joints = motion.joints()
    fingers = joints.copy()
    fingers[:, 22:] += rng.standard_normal((len(joints), 2, 3))
    np.testing.assert_array_equal(rhythm_curves(fingers, 60, names), rhythm_curves(joints, 60, names))


def test_a_single_frame_has_no_rhythm() -> None:
    motion = synthesise_motion(CLIPS[0], n_frames=1)[0]
    assert rhythm_curves(motion.joints(), 60, motion.skeleton.joints).shape == (1, 4)
