"""The fast version against the plain one, window by window, on music and on trouble.

Gates as for the reference outputs: envelope 1e-4, MFCC 1e-3, chroma 1e-6, peaks and beats equal. Measured on
2,944 windows and 40 tracks of real music (15.36 to 48 kHz, mono and stereo, windows of 5 and 10 s, with and
without a tempo, clipped): 2.5e-5, 4.3e-4, 0, equal.
"""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr
from numpy.typing import NDArray

from dancedata.audio._settings import log_once
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.audio.librosa35.filters import filter_bank
from dancedata.audio.librosa35.resample import MAX_PERIOD, period
from dancedata.audio.librosa35.tuning import N_TUNINGS
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.music.signal import load_audio
from dancedata.synthetic import synthesise_song
from tests.features import LIBROSA35, assert_within

GRID = FrameGrid.of(30)
FAST, PLAIN = Librosa35(), Librosa35(method="librosa")


def _assert_agree(found, expected, **gates):
    assert_within({**LIBROSA35, **gates}, FAST.columns, found, expected)


def _assert_windows_agree(signal, starts, n_samples, start_bpm=100.0, **gates):
    n_rows = FAST.n_rows(n_samples, signal.sample_rate, GRID)
    arguments = signal, np.array(starts), n_samples, GRID, n_rows
    _assert_agree(*(f.extract_windows(*arguments, start_bpm=start_bpm) for f in (FAST, PLAIN)), **gates)


def _assert_tracks_agree(signal, grid=GRID, start_bpm=90.0, **gates):
    _assert_agree(*(f.extract(signal, grid, start_bpm=start_bpm) for f in (FAST, PLAIN)), **gates)


def _song(rate: int, seconds: float = 8.0, music: str = "mPO1") -> NDArray[np.float32]:
    return synthesise_song(music, length_s=seconds, sample_rate=rate, n_channels=1).signal.samples


# At 11,025 Hz every second start is between frames, at 44,056 Hz nearly all do.
@pytest.mark.parametrize("rate", [48000, 22050, 15360, 8000, 11025, 44056])
def test_sample_rates(rate):
    starts = [int(k * 0.5 * rate) for k in (1, 6)]
    _assert_windows_agree(AudioSignal(_song(rate), rate), starts, 5 * rate)


@pytest.mark.parametrize("seconds", [0.3, 1.9, 3.21])
def test_window_lengths(seconds):
    _assert_windows_agree(AudioSignal(_song(44100, 11.0), 44100), [0, 22050], int(seconds * 44100))


def test_starts_between_frames_twice_and_out_of_order_and_no_tempo():
    _assert_windows_agree(AudioSignal(_song(48000), 48000), [96000, 1, 24000, 24000], 5 * 48000)
    _assert_windows_agree(AudioSignal(_song(44100), 44100), [0, 22050], 5 * 44100, start_bpm=None)


@pytest.mark.parametrize("fps", [60, 24, 17])
def test_frame_rates(fps):
    _assert_tracks_agree(AudioSignal(_song(44100), 44100), FrameGrid.of(fps))


def test_frame_rates_at_which_filters_are_half_as_long_for_some_tunings() -> None:
    fps, rate, n_samples = 20, 16000, 120_000
    grid = FrameGrid.of(fps)
    starts = np.arange(0, 9, 2) * rate
    halves = {len(filter_bank(tuning, 512 * fps).even) for tuning in range(N_TUNINGS)}
    assert len(halves) == 2
    # The tuning rises from the one kind to the other.
    cents = np.repeat(np.linspace(-45, 45, 16), rate)
    tones = sum(np.sin(np.cumsum(2 * np.pi * hz / rate * 2 ** (cents / 1200))) for hz in (220.0, 277.18, 329.63))
    signal = AudioSignal((0.2 * np.asarray(tones)).astype(np.float32), rate)
    arguments = n_samples, grid, FAST.n_rows(n_samples, rate, grid)
    found = FAST.extract_windows(signal, starts, *arguments, start_bpm=100.0)
    _assert_agree(found, PLAIN.extract_windows(signal, starts, *arguments, start_bpm=100.0))
    for k in (0, 2, 4):
        alone = FAST.extract_windows(signal, starts[k : k + 1], *arguments, start_bpm=100.0)
        np.testing.assert_array_equal(alone[0], found[k])


TIME, NOISE = np.arange(8 * 44100) / 44100, np.random.default_rng(4).uniform(-1, 1, 8 * 44100)
#: Of a song: what becomes of it, or other sounds of its length.
TROUBLE = {
    "silence": lambda song: 0 * song,
    "click": lambda song: np.eye(1, len(song), len(song) // 2)[0],
    "clicks": lambda song: np.arange(len(song)) % 22050 == 100,
    "clipped": lambda song: np.clip(20 * song, -1, 1),
    "faint": lambda song: song * np.float32(1e-4),
    "noise": lambda song: NOISE,
    "sine": lambda song: 0.5 * np.sin(2 * np.pi * 440 * TIME),
    "constant": lambda song: np.full(len(song), 0.25),
    "silence in between": lambda song: song * ((TIME < 2) | (TIME > 5)),
    "silence first": lambda song: song * (TIME > 4.2),
    "faded in": lambda song: song * np.minimum(1, np.exp(3 * (TIME - 5))).astype(np.float32),
    "loud after faint": lambda song: song * np.where(TIME > 4, 1, 1e-3).astype(np.float32),
}


@pytest.mark.parametrize("kind", TROUBLE)
def test_trouble(kind):
    rate = 44100
    signal = AudioSignal(np.asarray(TROUBLE[kind](_song(rate)), dtype=np.float32), rate)
    _assert_windows_agree(signal, [22050, 3 * rate], 5 * rate)
    _assert_tracks_agree(signal)


def _offset(kind: str, rate: int) -> NDArray[np.float32]:
    """Return 8 s of sounds that are faint relative to an offset, or to a tone below every filter."""
    n = 8 * rate
    noise, time_s = np.random.default_rng(4).uniform(-1, 1, n), np.arange(n) / rate
    made = {
        "constant": np.full(n, 0.25),
        "noise": 0.5 + 0.01 * noise,
        "faint noise": 0.5 + 0.001 * noise,
        "hardly any noise": 0.25 + 1e-5 * noise,
        "song": 0.5 + 0.05 * _song(rate)[:n],
        "sine": 0.5 + 0.01 * np.sin(2 * np.pi * 440 * time_s),
        "subsonic": 0.8 * np.sin(2 * np.pi * 5 * time_s) + 0.003 * noise,
    }
    return made[kind].astype(np.float32)


OFFSETS = ["constant", "noise", "faint noise", "hardly any noise", "song", "sine", "subsonic"]


# All kinds at one rate, the faintest at the others, and a tone whose peaks are near ties at 47,952 Hz.
@pytest.mark.parametrize(
    ("kind", "rate"),
    [*((kind, 16000) for kind in OFFSETS), *(("hardly any noise", r) for r in (37800, 47952)), ("sine", 47952)],
)
def test_offsets(kind: str, rate: int) -> None:
    """Decisions are librosa's here, too. Of the rest, float32 leaves less: nearly all bands lie 50 to 80 dB down."""
    signal = AudioSignal(_offset(kind, rate), rate)
    gates = {"onset_envelope": 3e-4, "mfcc": 4e-3}
    _assert_windows_agree(signal, [k * rate // 2 for k in (0, 1, 5)], 5 * rate, **gates)
    _assert_tracks_agree(signal, **gates)


def test_rates_that_hardly_ever_coincide(caplog: pytest.LogCaptureFixture) -> None:
    """Tables of responses would take 26 GB: windows are computed one by one instead, in little memory."""
    rate = 44101
    log_once.cache_clear()
    assert period(rate, 15360) > MAX_PERIOD
    signal = AudioSignal(_song(rate), rate)
    tracemalloc.start()
    try:
        _assert_windows_agree(signal, [0, rate // 2, rate], 5 * rate)
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()
    assert [f"samples at {rate} Hz and at 15360 Hz coincide" in message for message in caplog.messages] == [True]


def _recording(path: Path, folder: Path, rate: int, n_channels: int, gain: float) -> AudioSignal:
    """Return 33 s of a recording, as a wav file at another rate gives them; a gain above 1 clips."""
    samples, own_rate = soundfile.read(path, frames=33 * 44100, dtype="float32")
    changed = soxr.resample(samples[:, :n_channels], own_rate, rate)
    soundfile.write(folder / "song.wav", np.clip(gain * changed, -1, 1), rate, subtype="PCM_16")
    return load_audio(folder / "song.wav")


VIBE_ACE, FISHIN = "Kevin_MacLeod_-_Vibe_Ace.hq.ogg", "Karissa_Hobbs_-_Lets_Go_Fishin.hq.ogg"


@pytest.mark.parametrize(
    ("song", "rate", "n_channels", "seconds", "start_bpm", "gain"),
    [(VIBE_ACE, 44100, 2, 5, 112.0, 1), (FISHIN, 44100, 1, 5, 112.0, 1), (VIBE_ACE, 22050, 1, 5, None, 1),
     (FISHIN, 15360, 2, 10, 97.0, 1), (VIBE_ACE, 48000, 1, 10, 97.0, 1), (FISHIN, 48000, 2, 5, 112.0, 1),
     (VIBE_ACE, 44100, 2, 5, 112.0, 12)],
)  # fmt: skip
def test_real_music(shared, tmp_path, song, rate, n_channels, seconds, start_bpm, gain):
    signal = _recording(shared / "realdata" / "music" / song, tmp_path, rate, n_channels, gain)
    starts = [int(k * 0.5 * rate) for k in (1, 45)]
    _assert_windows_agree(signal, starts, seconds * rate, start_bpm=start_bpm)
    _assert_tracks_agree(AudioSignal(signal.samples[: 9 * rate], rate), start_bpm=start_bpm)
