"""The recipe feature: EDGE's windows, whole songs in contexts, precision and weights fixed by a build."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")

import itertools
import math
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from dancedata.audio.jukebox import JukeboxEncoder
from dancedata.audio.jukebox.feature import ENVIRONMENT, TAIL_S, Jukebox, contexts_of, unit_of
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.errors import DanceDataError, DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.files.regular_file import sha256_file
from dancedata.music.samples import resample

FPS = FrameGrid.of(30)
LAYER = 6


@pytest.fixture(scope="module")
def feature(tiny: SimpleNamespace) -> Jukebox:
    return Jukebox(weights=tiny.folder, layer=LAYER, device="cpu").resolved(sha256_file)


@pytest.fixture(scope="module")
def song() -> AudioSignal:
    """31 s of bursts and tones at 22,050 Hz: two contexts."""
    time_s = np.arange(31 * 22050) / 22050
    noise = np.random.default_rng(0).normal(0, 0.2, len(time_s)) * np.exp(-8 * (time_s % 0.5))
    return AudioSignal((noise + 0.1 * np.sin(2 * np.pi * 220 * time_s * (1 + time_s / 60))).astype(np.float32), 22050)


@pytest.fixture(scope="module")
def rows(feature: Jukebox, song: AudioSignal) -> np.ndarray:
    return feature.extract(song, FPS)


def _same(rows: np.ndarray, wanted: np.ndarray) -> None:
    """Equal up to one step of float16: on another number of threads float32 sums end in other last digits."""
    np.testing.assert_allclose(rows.astype(np.float32), wanted, rtol=2**-10, atol=2**-12)


def test_windows_are_clips_by_themselves(feature: Jukebox, song: AudioSignal, tiny_encoder: JukeboxEncoder) -> None:
    starts = np.array([0, 11_025, 33_333])
    rows = feature.extract_windows(song, starts, 5 * 22050, FPS, 150)
    assert rows.shape == (3, 150, 40)
    assert rows.dtype == np.float16
    for own, start in zip(rows, starts, strict=True):
        clip = pcm16(song.samples[start : start + 5 * 22050])
        wanted = tiny_encoder(clip, 22050)[LAYER]
        _same(own, wanted)


def test_a_song_within_one_context_is_one_clip(feature, song, tiny_encoder):
    short = song.part(0, 20 * 22050)
    rows = feature.extract(short, FPS)
    assert len(rows) == feature.n_rows(short.n_samples, 22050, FPS) == 600
    _same(rows, tiny_encoder(short.samples, 22050)[LAYER])


def test_a_longer_song_joins_contexts_without_a_gap(feature, song, rows, tiny_encoder):
    assert len(rows) == feature.n_rows(song.n_samples, 22050, FPS) == 930
    # Contexts of 704 rows overlap by 128, of which the last 16 of the first and 112 of the second are dropped.
    first = tiny_encoder(song.samples[: 704 * 735], 22050)[LAYER]
    assert len(first) == 704
    peaks = [np.abs(resample(part, 22050, 44100)).max() for part in (song.samples, song.samples[: 704 * 735])]
    if np.isclose(*peaks, rtol=1e-3):
        # One gain for the song: a context alone differs where its own peak is another.
        assert np.corrcoef(rows[:600].ravel().astype(float), first[:600].ravel())[0, 1] > 0.9
    assert np.isfinite(rows).all()


def test_rows_before_a_context_ends_do_not_depend_on_later_music(feature, song, rows):
    # The transformer is causal; what follows a context is heard by neither its codes nor its rows.
    loud = song.samples.copy()
    loud[28 * 22050 :] *= 0.5
    two = feature.extract(AudioSignal(loud, 22050), FPS)
    peak = np.abs(song.samples).argmax() / 22050
    assert peak < 28
    np.testing.assert_array_equal(rows[: 704 - 16], two[: 704 - 16])
    assert not np.array_equal(rows, two)


def test_a_build_fixes_precision_and_weights(tiny: SimpleNamespace, feature: Jukebox) -> None:
    assert feature.precision == "fp32"
    assert len(feature.weights_sha256) == 64
    with pytest.raises(UsageError, match="do not match the recipe"):
        Jukebox(weights=tiny.folder, weights_sha256="0" * 64, device="cpu").resolved(sha256_file)


def test_where_the_weights_are(tiny: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ENVIRONMENT, raising=False)
    with raises_message(UsageError, "DANCEDATA_JUKEBOX"):
        Jukebox().resolved(sha256_file)
    with raises_message(SourceError, "Jukebox", where="none"):
        Jukebox(weights=tmp_path / "none").resolved(sha256_file)
    with raises_message(SourceError, "Jukebox"):
        Jukebox(weights=tmp_path).resolved(sha256_file)
    monkeypatch.setenv(ENVIRONMENT, str(tiny.folder))
    assert Jukebox(layer=LAYER, device="cpu").resolved(sha256_file).weights == tiny.folder
    assert Jukebox().columns.width == tiny.config.width


def test_invalid_audio_is_refused(feature: Jukebox, song: AudioSignal) -> None:
    with raises_message(DataError, "reaches", reason="short_audio"):
        feature.extract_windows(song, np.array([song.n_samples]), 22050, FPS, 30)
    with raises_message(DataError, "short", reason="short_audio"):
        feature.extract(AudioSignal(np.zeros(50, np.float32), 44100), FPS)
    with raises_message(DataError, "too_long", reason="long_audio"):
        feature.extract_windows(song, np.array([0]), 25 * 22050, FPS, 750)
    with raises_message(DanceDataError, "contexts"):
        feature.n_rows(1, 44100, FrameGrid.of("30000/1001"))
    with raises_message(UsageError, "batch_size"):
        Jukebox(layer=0)


# ---- a song in contexts: every row once, codes and rows that meet, overlap as asked


RATE = Fraction(44100, 128)


def test_codes_and_rows_meet_every_735_codes() -> None:
    assert unit_of(RATE, Fraction(30)) == (735, 64)
    assert unit_of(RATE, Fraction(60)) == (735, 128)


@given(st.integers(1, 200_000), st.sampled_from([30, 60, 15]), st.fractions(1, 12))
def test_every_row_of_the_song_once(n_codes: int, fps: int, overlap_s: Fraction) -> None:
    parts = contexts_of(n_codes, n_ctx=8192, code_rate=RATE, fps=Fraction(fps), overlap_s=overlap_s)
    rows = [part.first_row + k for part in parts for k in range(part.keep_from, part.keep_to)]
    assert rows == list(range(math.ceil(n_codes * Fraction(fps) / RATE)))
    for part in parts:
        assert part.n_codes <= 8192
        # A context begins at one instant, in codes and in rows.
        assert Fraction(part.first_code) / RATE == Fraction(part.first_row, fps)
    for one, two in itertools.pairwise(parts):
        shared = Fraction(one.first_code + one.n_codes - two.first_code) / RATE
        assert shared >= overlap_s
        # Warm-up and tail are what is shared and not kept.
        assert two.keep_from + math.ceil(TAIL_S * fps) == shared * fps
    assert parts[-1].first_code + parts[-1].n_codes == n_codes


def test_a_song_costs_a_tenth_of_its_windows() -> None:
    n_codes = int(180 * RATE)
    parts = contexts_of(n_codes, n_ctx=8192, code_rate=RATE, fps=Fraction(30), overlap_s=Fraction(4))
    windows = (180 - 5) * 2 + 1  # 5 s every half second
    assert sum(part.n_codes for part in parts) < windows * 1722 / 8


@pytest.mark.parametrize("overlap_s", [0, 22, 100])
def test_an_overlap_that_cannot_be(overlap_s: Fraction) -> None:
    with raises_message(UsageError, "overlap_s"):
        contexts_of(20_000, n_ctx=8192, code_rate=RATE, fps=Fraction(30), overlap_s=Fraction(overlap_s))


def test_a_rate_whose_rows_never_meet_the_codes() -> None:
    with raises_message(UsageError, "contexts"):
        contexts_of(20_000, n_ctx=8192, code_rate=RATE, fps=Fraction("29.97"), overlap_s=Fraction(4))
