"""Soft cues and their mirror images on the beats."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.columns import Mirror
from dancedata.core.errors import UsageError
from dancedata.keymotion import Primitives, choreographic_augmentation, primitives
from tests.messages import raises_message

WIDTH = 9
MIRROR = Mirror((1, 0, 3, 2, 4, 5, 6, 8, 7), (1, 1, 1, 1, -1, 1, 1, -1, -1))
#: Centres of the code in 1024 frames.
CODE = [low + c for low in range(0, 1024, 256) for c in (32, 64, 160, 192)]


def cues(n_window: int = 1024, n: int = 256, dtype: str = "float32") -> Primitives:
    window = np.random.default_rng(0).normal(size=(n_window, WIDTH)).astype(dtype)
    return primitives(window, n_window, n, minima=[], prominence=[])


def centres(beats: object, n_window: int = 1024, n: int = 256) -> list[int]:
    return (choreographic_augmentation(cues(n_window, n), beats, MIRROR).start + 4).tolist()


def test_without_beats_cues_stand_where_the_code_puts_them() -> None:
    source = cues()
    before = hashlib.sha256(source.frames.tobytes()).digest()
    placed = choreographic_augmentation(source, [], MIRROR)
    assert placed.start.tolist()[:4] == [28, 60, 156, 188]
    assert (placed.start + 4).tolist() == CODE
    assert not placed.on_beat.any()
    assert placed.mirrored.tolist() == [False, True] * 8
    assert np.flatnonzero(placed.free).tolist() == [4, 5, 6]
    soft = source.frames[~source.hard]
    assert placed.frames.shape == (16, 8, WIDTH)
    assert placed.frames.dtype == np.float32
    np.testing.assert_array_equal(placed.frames[0::2], soft)
    np.testing.assert_array_equal(placed.frames[1::2], MIRROR.apply(soft))
    placed.frames[:] = 0
    assert hashlib.sha256(source.frames.tobytes()).digest() == before


@pytest.mark.parametrize(
    ("beats", "first"),
    [
        ([32], [32, 64]),
        ([44], [44, 64]),  # 12 frames are near enough
        ([45], [32, 64]),  # 13 are not
        ([20], [20, 64]),
        ([19], [32, 64]),
        ([30, 35], [30, 64]),  # the nearest
        ([29, 35], [29, 64]),  # of equally near ones the earlier
        ([44, 52], [44, 52]),  # each as near to the other as they can come: side by side
        ([48], [32, 64]),  # in the middle: 16 from either
        ([0, 4], [32, 64]),
    ],
)
def test_centres_move_to_the_nearest_beat(beats: list[int], first: list[int]) -> None:
    placed = choreographic_augmentation(cues(), beats, MIRROR)
    assert (placed.start + 4).tolist() == first + CODE[2:]
    assert placed.on_beat.tolist()[:2] == [f in beats for f in first]


def test_order_and_repetition_of_beats_do_not_matter() -> None:
    assert centres([190, 30, 30, 70]) == centres([30, 70, 190]) == [30, 70, 160, 190, *CODE[4:]]


def test_a_regular_beat_takes_all() -> None:
    beats = np.arange(7, 1024, 15)  # 120 a minute
    placed = choreographic_augmentation(cues(), beats, MIRROR)
    assert placed.on_beat.all()
    assert np.isin(placed.start + 4, beats).all()


def test_a_beat_is_taken_once() -> None:
    # 96 frames: centres 12, 24, 60, 72; the first takes 16, the second may not come so close.
    assert centres([16], 96, 96) == [16, 24, 60, 72]
    assert centres([18], 96, 96) == [12, 24, 60, 72]  # would overlap the image at 24, and the first stays at 12
    assert centres([16, 18, 24], 96, 96) == [16, 24, 60, 72]
    assert centres([66], 96, 96) == [12, 24, 60, 72]


def test_hard_cues_keep_their_frames() -> None:
    # 64 frames: centres 8, 16, 40, 48. Frames 0 .. 3 and 60 .. 63 belong to hard cues.
    assert centres([7, 57], 64, 64) == [8, 16, 40, 48]
    assert centres([56], 64, 64) == [8, 16, 40, 56]
    assert centres([8], 96, 96) == [8, 24, 60, 72]
    assert centres([7], 96, 96) == [12, 24, 60, 72]


@st.composite
def beats_and_lengths(draw: st.DrawFn) -> tuple[int, int, list[int]]:
    n, segments = draw(st.integers(64, 300)), draw(st.integers(1, 4))
    return n, segments, draw(st.lists(st.integers(0, n * segments - 1), max_size=80))


@given(beats_and_lengths())
def test_any_beats(case: tuple[int, int, list[int]]) -> None:
    n, segments, beats = case
    source = cues(n * segments, n)
    placed = choreographic_augmentation(source, beats, MIRROR)
    where = placed.start + 4
    code = np.array([low + c for low in range(0, n * segments, n) for c in (n // 8, n // 4, 5 * n // 8, 3 * n // 4)])
    assert (np.diff(placed.start) >= 8).all()  # no overlap, so no beat twice
    assert np.isin(where[placed.on_beat], beats).all()
    assert (where[~placed.on_beat] == code[~placed.on_beat]).all()
    assert (np.abs(where - code) <= 12).all()
    low = np.arange(len(where)) // 4 * n
    assert (placed.start - low >= 4).all()
    assert (placed.start + 8 - low <= n - 4).all()
    if n >= 256:  # nothing but distance counts
        for centre, at, moved in zip(code, where, placed.on_beat, strict=True):
            near = [b for b in beats if abs(b - centre) <= 12]
            assert moved == bool(near)
            assert not near or abs(at - centre) == min(abs(b - centre) for b in near)


def test_cues_of_the_released_code(dance, columns) -> None:
    source = primitives(columns(dance(1024)), variant="code")
    mirror = Mirror(tuple(range(139)), (1,) * 139)
    placed = choreographic_augmentation(source, [30], mirror)
    np.testing.assert_array_equal(placed.frames[0::2], source.frames[~source.hard])
    assert placed.start[0] == 26


@pytest.mark.parametrize(
    "beats",
    [
        [1024],
        [-1],
        [1.0, 2.0],
        np.zeros(1024, dtype=bool),
        [[1, 2]],
        5,
    ],
)
def test_invalid_beats(beats: object) -> None:
    with raises_message(UsageError, "beats"):
        choreographic_augmentation(cues(), beats, MIRROR)


def test_mirror_of_other_columns() -> None:
    with raises_message(UsageError, r"ds\.fields"):
        choreographic_augmentation(cues(), [], Mirror((0, 1), (1, 1)))
    narrow = primitives(np.zeros((256, 2)), 256, 256, minima=[], prominence=[])
    with raises_message(UsageError, r"ds\.fields"):
        choreographic_augmentation(narrow, [], Mirror((0, 1), (1, 1)))


def test_segments_too_short() -> None:
    with raises_message(UsageError, "segment"):
        centres([], 120, 60)
