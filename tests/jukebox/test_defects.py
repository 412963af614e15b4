"""Defects of the reference implementations (jukemirlib, transformers) that this one does not have."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import scipy.signal

from dancedata.audio.jukebox import JukeboxEncoder
from dancedata.audio.jukebox.clips import prepare
from dancedata.core.errors import DataError, UsageError

TOLERANCE = 2e-5


def _resampled(encoder: Any, codes: np.ndarray, n: int) -> np.ndarray:
    return scipy.signal.resample(encoder.activations(codes)[6], n)


@pytest.fixture(scope="module")
def clips() -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [(0.1 * rng.standard_normal(n)).astype(np.float32) for n in (9000, 9000, 9000, 20001, 12345, 128, 9000)]


@pytest.fixture(scope="module")
def one_by_one(tiny_encoder: Any, clips: list[np.ndarray]) -> list[dict[int, np.ndarray]]:
    return [tiny_encoder(clip, 44100) for clip in clips]


@pytest.mark.parametrize("sizes", [(2, 5, 1, 3), (7,), (1, 1)])
def test_batch_size_may_change_and_lengths_may_differ(tiny_encoder, clips, one_by_one, sizes):
    # jukemirlib keeps the conditioning of the first batch and fails with the next size, and for unequal lengths.
    for size in sizes:
        together = tiny_encoder.embed_batch(clips, 44100, batch_size=size)
        assert len(together) == len(clips)
        for found, expected in zip(together, one_by_one, strict=True):
            for layer in (2, 6):
                np.testing.assert_allclose(found[layer], expected[layer], rtol=0, atol=TOLERANCE)


def test_on_a_cpu_neighbours_do_not_matter_to_the_bit(tiny_encoder, clips, one_by_one):
    for found, expected in zip(tiny_encoder.embed_batch(clips[::-1], 44100), one_by_one[::-1], strict=True):
        np.testing.assert_array_equal(found[6], expected[6])


def test_sizes_of_batches(tiny_encoder: Any, clips: list[np.ndarray]) -> None:
    assert tiny_encoder.embed_batch([], 44100) == []
    with raises_message(UsageError, "batch_size"):
        tiny_encoder.embed_batch(clips, 44100, batch_size=0)


def test_under_one_code(tiny_encoder: Any) -> None:
    for call in (tiny_encoder, tiny_encoder.encode):
        with raises_message(DataError, "short", reason="short_audio"):
            call(np.ones(127, dtype=np.float32), 44100)
    with raises_message(DataError, "codes", reason="short_audio"):
        tiny_encoder.activations(np.zeros(0, dtype=np.int64))


@pytest.mark.parametrize("n", [128, 255, 256])
def test_one_code_or_two(tiny_encoder: Any, n: int) -> None:
    # jukemirlib squeezes one code to (W,) and resamples along the columns.
    samples = np.linspace(-1, 1, n, dtype=np.float32)
    codes = tiny_encoder.encode(samples, 44100)
    assert codes.shape == (n // 128,)
    activations = tiny_encoder.activations(codes)[6]
    assert activations.shape == (n // 128, 40)
    features = tiny_encoder(samples, 44100)[6]
    assert features.shape == (1, 40)
    np.testing.assert_allclose(features, scipy.signal.resample(activations, 1), atol=1e-6)


def test_limit_of_its_own(tiny: SimpleNamespace, noise: np.ndarray, tiny_encoder: Any) -> None:
    encoder = JukeboxEncoder(tiny.folder, layers=(6,), device="cpu", max_codes=100)
    with raises_message(DataError, "max_codes", reason="long_audio"):
        encoder(noise, 44100)  # the reference drops the rest without a word
    with raises_message(DataError, "too_long", reason="long_audio"):
        encoder.activations(np.zeros(101, dtype=np.int64))
    with raises_message(UsageError, "too_long"):
        encoder(noise, 44100, too_long="truncated")
    cut = encoder(noise, 44100, too_long="truncate")[6]
    assert cut.shape == (9, 40)
    # Codes near the cut are influenced by the music after it, as in the reference.
    codes = tiny_encoder.encode(noise, 44100)[:100]
    expected = scipy.signal.resample(tiny_encoder.activations(codes)[6], 9)
    np.testing.assert_allclose(cut, expected, rtol=0, atol=TOLERANCE)


def test_parts_of_a_prepared_song_keep_its_gain(tiny_encoder: Any, noise: np.ndarray) -> None:
    song = prepare(np.concatenate([noise, 4 * noise]), 44100, tiny_encoder.config)
    found = tiny_encoder.embed_prepared([song[:22050], song[44100:66150]])
    codes = tiny_encoder._encode_prepared([song[:22050]])[0]
    np.testing.assert_allclose(found[0][6], _resampled(tiny_encoder, codes, 15), rtol=0, atol=TOLERANCE)
    assert np.abs(found[0][6] - tiny_encoder(noise[:22050], 44100)[6]).max() > 0.1
    for n, reason in ((127, "short_audio"), (8193 * 128, "long_audio")):
        with raises_message(DataError, "jukebox", reason=reason):
            tiny_encoder.embed_prepared([np.zeros(n, dtype=np.float32)])


def test_gain_does_not_matter_and_channels_are_averaged(tiny_encoder: Any, noise: np.ndarray) -> None:
    wanted = tiny_encoder.encode(noise, 44100)
    # A quarter: a power of two, so that the division by the largest sample gives the same bits.
    for same in (noise / 4, np.stack([noise, np.zeros_like(noise)]), noise[None]):
        np.testing.assert_array_equal(tiny_encoder.encode(same, 44100), wanted)


@pytest.mark.parametrize(
    ("samples", "rate", "error", "message"),
    [
        (np.zeros(0, np.float32), 44100, DataError, "no samples"),
        (np.array([0, np.nan] * 100, np.float32), 44100, DataError, "not finite; found 100 samples"),
        (np.zeros(1000, np.int16), 44100, UsageError, "floating-point"),
        (np.zeros((44100, 2), np.float32), 44100, UsageError, r"\(channels, m\)"),
        (np.zeros((1, 2, 3), np.float32), 44100, UsageError, "invalid samples"),
        (np.zeros(1000, np.float32), 0, UsageError, "sample rate"),
    ],
)
def test_bad_samples(tiny_encoder: Any, samples: np.ndarray, rate: int, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        tiny_encoder(samples, rate)


@pytest.mark.parametrize("codes", [[0, 64], [-1], [0.5], [[1]]])
def test_bad_codes(tiny_encoder: Any, codes: list[Any]) -> None:
    with raises_message(UsageError, "codes"):
        tiny_encoder.activations(codes)


def test_a_prefix_has_the_activations_of_the_whole(tiny_encoder: Any) -> None:
    # Nothing sees the padding, or the future; the last code of a clip is never seen at all.
    codes = np.random.default_rng(3).integers(0, 64, 300)
    whole = tiny_encoder.activations(codes)[6]
    for n in (1, 63, 64, 65, 200):
        np.testing.assert_allclose(tiny_encoder.activations(codes[:n])[6], whole[:n], rtol=0, atol=TOLERANCE)
    changed = codes.copy()
    changed[199] = (changed[199] + 1) % 64
    np.testing.assert_allclose(tiny_encoder.activations(changed)[6][:200], whole[:200], rtol=0, atol=TOLERANCE)
    assert np.abs(tiny_encoder.activations(changed)[6][200:] - whole[200:]).max() > 0.1


@pytest.mark.parametrize("fps", [60, 29.97, 344.53125])
def test_frame_rates(tiny_encoder: Any, noise: np.ndarray, fps: float) -> None:
    activations = tiny_encoder.activations(tiny_encoder.encode(noise, 44100))[6]
    found = tiny_encoder(noise, 44100, fps=fps)[6]
    expected = scipy.signal.resample(activations, int(np.ceil(len(activations) * fps / 344.53125)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    with raises_message(UsageError, "jukebox"):
        tiny_encoder(noise, 44100, fps=0)
