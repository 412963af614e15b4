"""Time: frames, chunks and rows in exact numbers, and clicks that land where they are."""

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.families.base import Timing, chunks_of
from dancedata.audio.hf.rows import RowSum, frames_of, method_of, row_map
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid

from .conftest import ONE_OF_EACH, noise

MERT = Timing(24_000, Fraction(320), Fraction(399, 2))
CODEC = Timing(44_100, Fraction(512), Fraction(256))
#: CLAP: a hop that is not a whole number of samples.
CLAP = Timing(48_000, Fraction(32 * 480_000, 1023), Fraction(31, 2) * Fraction(480_000, 1023))
TIMINGS = st.sampled_from((MERT, CODEC, CLAP))
GRIDS = st.sampled_from([FrameGrid.of(fps) for fps in (30, 60, 24, 25, 75, "30000/1001", "1/7", 50, 120)])


@given(st.integers(1, 4_000_000), st.integers(1, 40), st.integers(0, 30), TIMINGS)
@settings(max_examples=100, deadline=None)
def test_chunks_cover_a_signal_and_keep_their_middles(n: int, units: int, less: int, timing: Timing) -> None:
    unit = int(timing.hop) if timing.hop.denominator == 1 else 1
    length, overlap = units * 8 * 320 * unit // 40, min(less, units - 1) * 8 * 320 * unit // 40 // 2
    length, overlap = length // unit * unit or unit, overlap // unit * unit
    if overlap >= length:
        overlap = 0
    if n // (length - overlap) > 300:
        n = 300 * (length - overlap)
    chunks = chunks_of(n, length=length, overlap=overlap, unit=unit, timing=timing)
    assert chunks[0].start == 0
    assert chunks[0].keep_from is None and chunks[-1].keep_to is None  # noqa: PT018
    assert chunks[-1].start + chunks[-1].n_samples == n
    for one, two in pairwise(chunks):
        assert one.n_samples == length
        assert two.start % unit == 0
        assert one.start < two.start <= one.start + length - overlap
        assert one.keep_to == two.keep_from
        middle = Fraction(two.start + one.start + length, 2)
        assert abs(one.keep_to - middle) <= timing.hop / 2
    assert length - unit < chunks[-1].n_samples <= length or len(chunks) == 1


def _all_frames(n_samples: int, timing: Timing, grid: FrameGrid, length: int, overlap: int) -> tuple[object, ...]:
    unit = int(timing.hop) if timing.hop.denominator == 1 else 1
    chunks = chunks_of(
        n_samples, length=length // unit * unit, overlap=overlap // unit * unit, unit=unit, timing=timing
    )
    counts = [int(-(-c.n_samples // timing.hop)) for c in chunks]
    return chunks, counts, frames_of(chunks, counts, timing, grid)


@given(st.integers(30_000, 400_000), GRIDS, TIMINGS, st.sampled_from(["area", "linear", "nearest"]))
@settings(max_examples=40, deadline=None)
def test_rows_equal_plain_arithmetic(n: int, grid: FrameGrid, timing: Timing, method: str) -> None:
    _, counts, frames = _all_frames(n, timing, grid, 4 * timing.sample_rate, timing.sample_rate)
    n_rows = FrameGrid.of(timing.sample_rate).resampled_length(n, grid)
    rng = np.random.default_rng(0)
    values = [rng.normal(size=(count, 2)).astype(np.float32) for count in counts]
    rows = RowSum(row_map(frames, n_rows, method), 2, lambda some: some)
    for k, own in enumerate(values):
        rows.add(k, own)
    found = rows.result()
    assert found.shape == (n_rows, 2)
    kept = np.stack([values[c][k] for c, k in zip(frames.chunk.tolist(), frames.number.tolist(), strict=True)])
    stamps = [Fraction(int(s), frames.ticks) for s in frames.stamp]
    spans = [
        (Fraction(int(b), frames.ticks), Fraction(int(e), frames.ticks))
        for b, e in zip(frames.begin, frames.end, strict=True)
    ]
    for j in {0, 1, n_rows // 3, n_rows // 2, n_rows - 2, n_rows - 1} & set(range(n_rows)):
        np.testing.assert_allclose(found[j], _plain(j, grid, kept, stamps, spans, method), atol=1e-5)


def _plain(j: int, grid: FrameGrid, kept: np.ndarray, stamps: list, spans: list, method: str) -> np.ndarray:
    """One row, by fractions."""
    t, half = j / grid.rate, 1 / (2 * grid.rate)
    ends = stamps[0], stamps[-1]
    near = [k for k, stamp in enumerate(stamps) if abs(stamp - t) < half + 1] or [
        0 if t < ends[0] else len(stamps) - 1
    ]
    kept, stamps, spans = kept[near], [stamps[k] for k in near], [spans[k] for k in near]
    if method == "area":
        weights = [max(Fraction(0), min(e, t + half) - max(b, t - half)) for b, e in spans]
        if sum(weights):
            return np.asarray(sum(float(w / sum(weights)) * v for w, v in zip(weights, kept, strict=True) if w))
        method = "nearest"
    distances = [abs(s - t) for s in stamps]
    if method == "nearest" or t <= ends[0] or t >= ends[1]:
        return np.asarray(kept[distances.index(min(distances))])
    k = max(i for i, s in enumerate(stamps) if s <= t)
    share = float((t - stamps[k]) / (stamps[k + 1] - stamps[k]))
    return np.asarray((1 - share) * kept[k] + share * kept[k + 1])


def test_resample_is_area_down_and_linear_up() -> None:
    found = {fps: method_of("auto", MERT, FrameGrid.of(fps), codes=False) for fps in (30, 75, 120)}
    assert found == {30: "area", 75: "linear", 120: "linear"}
    assert method_of("auto", MERT, FrameGrid.of(30), codes=True) == "nearest"
    assert method_of("linear", MERT, FrameGrid.of(30), codes=False) == "linear"


@pytest.mark.parametrize("kind", ONE_OF_EACH)
def test_as_many_frames_as_the_network_gives(kind, encoder, feature):
    own = encoder(kind)
    family = own.settings.family
    rng = np.random.default_rng(1)
    longest = min(own.settings.chunk_samples, family.sample_rate)
    longest = min(longest, 40 * int(family.timing.hop) + family.min_samples)
    lengths = {family.min_samples, longest, *rng.integers(family.min_samples, longest, 2)}
    for n in sorted(int(n) for n in lengths):
        found = own.frames(noise(n / family.sample_rate, family.sample_rate), family.sample_rate)
        assert len(found.values) == len(found.stamps_s) == family.n_frames(n), (kind, n)
        assert found.values.shape[1] == own.settings.width
    made = feature(kind)
    for rate, seconds, fps in ((8_000, 0.33, 30), (96_000, 0.41, "30000/1001")):
        signal = AudioSignal(noise(seconds, rate), rate)
        rows = made.extract(signal, FrameGrid.of(fps))
        assert len(rows) == made.n_rows(signal.n_samples, rate, FrameGrid.of(fps))


def _response(own: HuggingFaceEncoder, at: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Change of each frame of the front end with a click at sample `at`, and the frames' stamps in samples."""
    family = own.settings.family
    base = np.random.default_rng(0).normal(0, 0.1, n).astype(np.float32)
    click = base.copy()
    click[at] += 0.05  # too little to change what group norms divide the whole signal by
    if hasattr(own._network, "feature_extractor"):  # before attention and positional convolutions, which see all
        with torch.inference_mode():
            two = [own._network.feature_extractor(torch.from_numpy(x)[None])[0].numpy().T for x in (base, click)]
    elif own.settings.family.name == "pe-audio":  # before group normalisation
        with torch.inference_mode():
            two = [own._network.embedder(torch.from_numpy(x)[None, None])[0][0].numpy() for x in (base, click)]
    else:
        two = [own.frames(x, family.sample_rate).values for x in (base, click)]
    stamps = np.arange(len(two[0])) * float(family.timing.hop) + float(family.timing.first_centre)
    return np.abs(two[1] - two[0]).max(axis=1), stamps


CAUSAL = ("encodec24", "mimi")


@pytest.mark.parametrize("kind", [kind for kind in ONE_OF_EACH if kind not in CAUSAL])
def test_a_click_is_in_the_middle_of_the_frames_that_see_it(kind, encoder):
    """Within half a hop: as many frames respond before a click as after it."""
    own = encoder(kind, normalize="none", **({} if kind in ("clap", "dac") or "encodec" in kind else {"layers": 0}))
    family = own.settings.family
    hop, n = float(family.timing.hop), min(own.settings.chunk_samples, int(24 * family.timing.hop))
    clicks = [n // 2 + int(part * hop) for part in (0, 0.37, 0.81)]
    away = np.array([(_centre(kind, *_response(own, at, n)) - at) / hop for at in clicks])
    # CLAP's frames are 15 times as long as its patches, whose windows of attention end between two of them; and where
    # the energy of an LSTM lies depends on its weights, by up to half a hop. So of these the mean over clicks counts.
    scattered = kind == "clap" or "encodec" in kind
    assert np.abs(away.mean() if scattered else away).max() <= 0.5 + 1e-9


def _centre(kind: str, strength: np.ndarray, stamps: np.ndarray) -> float:
    """Stamp of a click, by how much each frame changes with it."""
    if "encodec" in kind:  # its LSTM carries up to a tenth of a click on for ten frames
        return float(np.average(stamps, weights=strength**2))
    # CLAP attends within windows of its map, so that only the strongest frame tells. Of the others every frame that
    # sees the click counts; group norm carries up to 2 % of it to all frames, which is why the limit is not 0.
    seen = np.flatnonzero(strength > (0.999 if kind == "clap" else 0.05) * strength.max())
    assert len(seen) <= 14
    return float(stamps[seen[0]] + stamps[seen[-1]]) / 2


@pytest.mark.parametrize("kind", CAUSAL)
def test_a_causal_codec_answers_first_in_the_frame_of_the_click(kind, encoder):
    own = encoder(kind)
    hop = int(own.settings.family.timing.hop)
    frame = 40 if kind == "encodec24" else 6  # far from the start, where paddings mirror what follows
    for at in (frame * hop, frame * hop + hop // 2, (frame + 1) * hop - 1):
        strength, stamps = _response(own, at, (frame + 10) * hop)
        first = np.flatnonzero(strength > 1e-3 * strength.max())[0]
        assert first == frame
        assert abs(stamps[first] - at) <= hop / 2


def test_the_row_nearest_to_a_click_is_the_largest(encoder: Callable[..., HuggingFaceEncoder]) -> None:
    own = encoder("wav2vec2-large", layers=0, normalize="none")
    base = np.random.default_rng(0).normal(0, 1e-3, 32_000).astype(np.float32)
    for at in (9_777, 16_004, 21_333):
        click = base.copy()
        click[at] += 0.5
        two = own.rows([base, click], 16_000, FrameGrid.of(30), 60, finish=lambda rows: rows)
        change = np.square(two[1] - two[0]).sum(axis=1)
        assert abs(int(change.argmax()) - at / 16_000 * 30) <= 0.5 + 0.3  # half a row, and half a hop
