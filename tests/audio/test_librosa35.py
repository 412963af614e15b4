"""librosa35 on sounds whose beats and chords are known, on trouble, and against EDGE, FACT and Lodge."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import librosa
import numpy as np
import pytest
from numpy.typing import NDArray

from dancedata.audio._settings import log_once
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.music.signal import load_audio
from tests.features import LIBROSA35, assert_within
from tests.messages import raises_message

GRID = FrameGrid.of(30)
FEATURE = Librosa35()
PLAIN = Librosa35(method="librosa")


def _signal(samples: NDArray[np.floating], rate: int = 15360) -> AudioSignal:
    return AudioSignal(np.asarray(samples, dtype=np.float32), rate)


def _plain_librosa(samples: NDArray[np.float32], rate: int, fps: int, start_bpm: float | None) -> NDArray[np.float32]:
    """FACT's, EDGE's and Lodge's function, one plain librosa call a column group."""
    sr = 512 * fps
    y = librosa.resample(samples, orig_sr=rate, target_sr=sr)
    envelope = librosa.onset.onset_strength(y=y, sr=sr)
    mfcc = librosa.feature.mfcc(y=y, sr=sr, n_mfcc=20).T
    chroma = librosa.feature.chroma_cens(y=y, sr=sr, hop_length=512, n_chroma=12).T
    peaks, beats = np.zeros_like(envelope), np.zeros_like(envelope)
    peaks[librosa.onset.onset_detect(onset_envelope=envelope.flatten(), sr=sr, hop_length=512)] = 1
    if start_bpm is None:
        start_bpm = librosa.feature.tempo(y=librosa.resample(samples, orig_sr=rate, target_sr=22050))[0]
    beats[
        librosa.beat.beat_track(onset_envelope=envelope, sr=sr, hop_length=512, start_bpm=start_bpm, tightness=100)[1]
    ] = 1
    return np.concatenate([envelope[:, None], mfcc, chroma, peaks[:, None], beats[:, None]], axis=-1)


@pytest.mark.parametrize(("fps", "start_bpm"), [(30, 120.0), (30, None), (60, 90.0), (25, None)])
def test_track_is_plain_librosa_to_the_bit(clicks: AudioSignal, fps: int, start_bpm: float | None) -> None:
    features = PLAIN.extract(clicks, FrameGrid.of(fps), start_bpm=start_bpm)
    assert features.dtype == np.float32
    assert np.array_equal(features, _plain_librosa(clicks.samples, 48000, fps, start_bpm))


@pytest.mark.parametrize("start_bpm", [120.0, None])
def test_windows_are_pieces_by_themselves(clicks: AudioSignal, start_bpm: float | None) -> None:
    starts = np.array([0, 24000, 144000])
    windows = PLAIN.extract_windows(clicks, starts, 240000, GRID, 150, start_bpm=start_bpm)
    assert windows.shape == (3, 150, 35)
    assert windows.dtype == np.float32
    assert not windows[:, :3, 0].any()  # lag of 1 and 2 frames of centring
    for window, start in zip(windows, starts, strict=True):
        piece = pcm16(clicks.samples[start : start + 240000])
        assert np.array_equal(window, _plain_librosa(piece, 48000, 30, start_bpm)[:150])


def test_beats_and_chord_are_found(clicks: AudioSignal) -> None:
    features = FEATURE.extract(clicks, GRID, start_bpm=120.0)
    assert features.shape == (241, 35)
    expected_s = np.arange(0.25, 7.9, 0.5)
    beats_s = np.flatnonzero(features[:, 34]) / 30
    peaks_s = np.flatnonzero(features[:, 33]) / 30
    assert len(beats_s) >= 13  # librosa trims weak beats at the ends
    for found_s in (beats_s, peaks_s[peaks_s > 0.15]):
        # The envelope's centring and lag move events by up to two frames.
        assert np.abs(found_s[:, None] - expected_s).min(axis=1).max() <= 2.01 / 30
    chroma = features[30:-30, 21:33].mean(axis=0)
    assert set(np.argsort(chroma)[-3:]) == {0, 4, 7}  # C, E, G


def test_tightness_is_used(clicks: AudioSignal) -> None:
    loose = Librosa35(tightness=0.01).extract(clicks, GRID, start_bpm=190.0)
    tight = Librosa35(tightness=10000).extract(clicks, GRID, start_bpm=190.0)
    assert np.array_equal(loose[:, :34], tight[:, :34])
    assert not np.array_equal(loose[:, 34], tight[:, 34])


@pytest.mark.parametrize(
    ("rate", "n_samples"),
    [(15360, n) for n in (1, 511, 512, 2048, 16383)]
    + [(48000, n) for n in (1, 1599, 1600, 1601, 4800)]
    + [(44100, n) for n in (1470, 22049, 22050)]
    + [(22050, 735), (8000, 1234)],
)
@pytest.mark.parametrize("fps", [30, 60])
def test_n_rows(rate: int, n_samples: int, fps: int) -> None:
    samples = np.random.default_rng(n_samples).uniform(-0.3, 0.3, n_samples)
    features = FEATURE.extract(_signal(samples, rate), FrameGrid.of(fps), start_bpm=120.0)
    assert features.shape == (FEATURE.n_rows(n_samples, rate, FrameGrid.of(fps)), 35)
    assert np.isfinite(features).all()


@pytest.mark.parametrize("n_samples", [1, 20000])
@pytest.mark.parametrize("kind", ["silence", "constant", "click", "sine", "whisper"])
@pytest.mark.parametrize("start_bpm", [100.0, None])
def test_odd_sounds(kind: str, n_samples: int, start_bpm: float | None) -> None:
    samples = {
        "silence": np.zeros(n_samples),
        "constant": np.full(n_samples, 0.5),
        "click": np.eye(1, n_samples, n_samples // 2)[0],
        "sine": np.sin(np.arange(n_samples) * 2 * np.pi * 440 / 15360),
        "whisper": np.random.default_rng(0).standard_normal(n_samples) * 1e-12,
    }[kind]
    features = FEATURE.extract(_signal(samples), GRID, start_bpm=start_bpm)
    assert features.shape == (1 + n_samples // 512, 35)
    assert np.isfinite(features).all()
    if kind == "silence":
        assert not features[:, 0].any()  # no onset
        assert not features[:, 21:].any()  # no pitch, peak or beat


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_samples_that_are_not_numbers(value: float) -> None:
    samples = np.zeros(16000)
    samples[77] = value
    with raises_message(DataError, "infinite|infinity", reason="nan"):
        FEATURE.extract(_signal(samples), GRID, start_bpm=120.0)
    with raises_message(DataError, "signal", reason="empty_audio"):
        FEATURE.extract(_signal(np.zeros(0)), GRID)
    # The largest allowed do not overflow.
    loud = 1e12 * np.sign(np.sin(np.arange(48000) * 2 * np.pi * 440 / 48000))
    assert np.isfinite(FEATURE.extract(_signal(loud, 48000), GRID)).all()


@pytest.mark.parametrize(
    ("starts", "n_rows", "word"),
    [*((s, 150, "reaches") for s in ([-1], [0, 144001], [400000])), ([0], 152, "librosa35")],
)
def test_windows_beyond_the_audio_or_too_short_for_their_rows(clicks, starts, n_rows, word):
    with raises_message(DataError, word, reason="short_audio"):
        FEATURE.extract_windows(clicks, np.array(starts), 240000, GRID, n_rows, start_bpm=120.0)


def test_no_windows(clicks: AudioSignal) -> None:
    none = np.zeros(0, dtype=np.int64)
    assert FEATURE.extract_windows(clicks, none, 240000, GRID, 150, start_bpm=120.0).shape == (0, 150, 35)


@pytest.mark.parametrize("rate", [Fraction(2997, 100), Fraction(30000, 1001), Fraction(15), Fraction(15, 2)])
def test_unsupported_frame_rates(clicks: AudioSignal, rate: Fraction) -> None:
    grid = FrameGrid.of(rate)
    with raises_message(UsageError, "librosa35"):
        FEATURE.n_rows(48000, 48000, grid)
    with raises_message(UsageError, "librosa35"):
        FEATURE.extract(clicks, grid)


@pytest.mark.parametrize("start_bpm", [0.0, -120.0, float("nan"), float("inf")])
def test_bad_tempo(clicks: AudioSignal, start_bpm: float) -> None:
    with raises_message(UsageError, "start_bpm"):
        FEATURE.extract(clicks, GRID, start_bpm=start_bpm)


@pytest.mark.parametrize("given", [*({"tightness": t} for t in (0.0, -1.0, float("nan"))), {"method": "slow"}])
def test_bad_settings(given):
    with raises_message(UsageError, next(iter(given))):
        Librosa35(**given)


@pytest.mark.parametrize(
    ("fps", "seconds", "level", "reason"),
    [(30, 0.4, 0.3, "more than 16 rows"), (65, 2.0, 0.3, "at 65 frames per second"),
     (30, 1.0, 1e-7, "the largest sample"), (30, 1.0, 0.3, ""), (64, 1.0, 0.3, "")],
)  # fmt: skip
def test_the_fallback_of_the_fast_version_is_logged_once(caplog, fps, seconds, level, reason):
    log_once.cache_clear()
    samples = np.random.default_rng(5).uniform(-level, level, int(seconds * 15360))
    with caplog.at_level("WARNING"):
        for feature in (FEATURE, FEATURE, PLAIN):
            feature.extract(_signal(samples), FrameGrid.of(fps), start_bpm=120.0)
    assert [reason in message for message in caplog.messages] == ([True] if reason else [])


# ---- against what EDGE, FACT and Lodge computed: gates just above what independent float32 reruns reached, far below
# what a wrong setting does. This version: envelope 3.8e-6, MFCC 9.2e-5, chroma 0; peaks and beats are equal or wrong.


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _song(peers: Any, clip: str) -> Path:
    (path,) = (peers / "inputs" / "edge_aistpp" / "wavs").glob(f"{clip}.*")
    return path


def _bpm(clip: str) -> float:
    """AIST++: 80 + 10 n by the music id, house 110 + 5 n."""
    music = clip.split("_")[4]
    return 110 + 5 * int(music[-1]) if music.startswith("mHO") else 80 + 10 * int(music[-1])


@pytest.mark.parametrize(("split", "n_windows"), [("train", 47), ("test", 15)])
def test_edge_windows(peers: Any, split: str, n_windows: int) -> None:
    names = _json(peers / f"edge_windows_{split}.json")
    golden = peers.load(f"edge_{split}.npz")
    expected, windows_there = golden["baseline35"], golden.index("baseline35")
    assert (len(names), 150, 35) == golden.shape("baseline35")
    assert len(names) == n_windows
    assert len(expected) >= 2
    rows: dict[str, list[tuple[int, int]]] = {}
    for row, name in enumerate(names[k] for k in windows_there):
        clip, _, k = name.rpartition("_slice")
        rows.setdefault(clip, []).append((row, int(k)))
    for clip, windows in rows.items():
        signal = load_audio(_song(peers, clip))
        starts = np.array([k * signal.sample_rate // 2 for _, k in windows])
        features = FEATURE.extract_windows(
            signal, starts, 5 * signal.sample_rate, FrameGrid.of(30), 150, start_bpm=_bpm(clip)
        )
        assert_within(LIBROSA35, FEATURE.columns, features, expected[[row for row, _ in windows]])


def test_edge_slice_samples(peers: Any) -> None:
    arrays = peers.load("edge_slice_pcm.npz")
    name, expected = str(arrays["name"]), arrays["pcm"]
    clip, _, k = name.removesuffix(".wav").rpartition("_slice")
    signal = load_audio(_song(peers, clip))
    start = int(k) * signal.sample_rate // 2
    steps = pcm16(signal.samples[start : start + len(expected)]) * 32768
    assert np.array_equal(steps, expected)


def test_fact_tracks_at_60_fps(peers: Any) -> None:
    sources = _json(peers / "fact_audio_source.json")
    expected = peers.load("fact_audio35_60fps.npz")
    assert set(expected) == set(sources)
    for music, clip in sources.items():
        signal = load_audio(_song(peers, clip))
        features = FEATURE.extract(signal, FrameGrid.of(60), start_bpm=_bpm(clip))
        assert_within(LIBROSA35, FEATURE.columns, features, expected[music])


def test_lodge_tracks_without_a_known_tempo(peers: Any) -> None:
    expected = peers.load("lodge_music35.npz")
    assert len(expected)
    for track, rows in expected.items():
        (path,) = (peers / "inputs" / "finedance" / "music_wav").glob(f"{track}.*")
        assert_within(LIBROSA35, FEATURE.columns, FEATURE.extract(load_audio(path), FrameGrid.of(30)), rows)
