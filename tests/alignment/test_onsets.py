"""Onset strength: where an onset is, against a plain loop, and on signals without any."""

import numpy as np
import pytest

from dancedata.alignment.onsets import BANDS_HZ, onset_strength
from dancedata.core.audio_signal import AudioSignal

RATE = 240


def bursts(rate: int, times: tuple[float, ...], seconds: float = 3.0) -> AudioSignal:
    """Noise that begins suddenly and decays, over a noise floor."""
    rng = np.random.default_rng(0)
    samples = 1e-4 * rng.standard_normal(round(seconds * rate))
    t = np.arange(round(0.3 * rate)) / rate
    for time in times:
        burst = 0.4 * rng.standard_normal(len(t)) * np.exp(-t / 0.05)
        rest = samples[round(time * rate) :][: len(t)]
        rest += burst[: len(rest)]
    return AudioSignal(samples.astype(np.float32), rate)


@pytest.mark.parametrize("rate", [22_050, 44_100, 48_000])
def test_an_onset_is_within_a_row_of_its_peak(rate: int) -> None:
    times = (0.5, 1.2345, 2.0)
    strength = onset_strength(bursts(rate, times))
    for time in times:
        near = slice(round(time * RATE) - 30, round(time * RATE) + 30)
        peaks = near.start + strength[near].argmax(axis=0)
        assert np.abs(peaks / RATE - time).max() < 0.0045


def test_it_agrees_with_a_plain_loop() -> None:
    signal = bursts(8_000, (0.3,), seconds=0.5)
    samples = signal.samples.astype(np.float64)
    half, early = round(0.012 * 8_000), round(0.005 * 8_000)
    power = np.zeros((120, 3))
    frequencies = np.arange(129) * 8_000 / 256
    for row in range(120):
        centre = row * 8_000 // 240 - early
        piece = np.array([samples[i] if 0 <= i < len(samples) else 0 for i in range(centre - half, centre + half)])
        window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(2 * half) / (2 * half))
        energy = np.abs(np.fft.fft(piece * window, 256)[:129]) ** 2
        for band in range(3):
            inside = (frequencies >= BANDS_HZ[band] - 16) & (frequencies < BANDS_HZ[band + 1] - 16)
            power[row, band] = energy[inside].sum()
    level = 10 * np.log10(power + 1e-4 * power.max(axis=0) + 1e-20)
    expected = np.array([
        np.maximum(level[min(row + 2, 119)] - level[max(row - 2, 0)], 0) for row in range(120)
    ])  # fmt: skip
    np.testing.assert_allclose(onset_strength(signal), expected, atol=1e-6)


def test_silence_and_signals_shorter_than_a_row_have_none() -> None:
    assert not onset_strength(AudioSignal(np.zeros(4_000, np.float32), 8_000)).any()
    assert onset_strength(AudioSignal(np.ones(10, np.float32), 8_000)).shape == (0, 3)


def test_loudness_does_not_matter() -> None:
    signal = bursts(16_000, (1.0,), seconds=2)
    quiet = AudioSignal(signal.samples * np.float32(0.125), 16_000)
    np.testing.assert_allclose(onset_strength(quiet), onset_strength(signal), atol=1e-4)
