"""Primitives as the paper describes them."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.keymotion import Primitives, borders, primitives
from dancedata.keymotion.lodge import Lodge
from dancedata.metrics.key_motion import KeyMotion
from tests.messages import raises_message

#: Results of 4 segments, in the order of time.
HARD_13 = [True, False, False] * 4 + [True]


def digest(array: np.ndarray) -> str:
    return hashlib.sha256(array.tobytes()).hexdigest()


def check(cues: Primitives, window: np.ndarray, minima: np.ndarray) -> None:
    """Check the invariants of every window."""
    n_window, n = cues.n_window, cues.n_segment
    segments = n_window // n
    assert len(cues.start) == 3 * segments + 1 == len(cues.frames) == len(cues.source)
    assert cues.hard.tolist() == [True, False, False] * segments + [True]
    assert cues.start[cues.hard].tolist() == [0, *range(n - 4, n_window - n, n), n_window - 8]
    assert [s for s, h in zip(cues.source, cues.hard, strict=True) if h] == [
        "start",
        *["border"] * (segments - 1),
        "end",
    ]
    assert (np.diff(cues.start) >= 8).all()  # in the order of time, and none overlaps
    assert cues.start[0] >= 0
    assert cues.start[-1] + 8 <= n_window
    for cue, start in zip(cues.frames, cues.start, strict=True):
        np.testing.assert_array_equal(cue, window[start : start + 8])
    centres = cues.start[~cues.hard] + 4
    for centre, filled, k in zip(centres, cues.filled[~cues.hard], range(2 * segments), strict=True):
        low = k // 2 * n
        assert low + 12 <= centre <= low + n - 12
        assert filled or centre in minima
    assert not cues.filled[cues.hard].any()
    assert [s == "filled" for s in cues.source] == cues.filled.tolist()


def test_primitives_of_a_clip(dance, columns) -> None:
    check_clip(dance(1800, seed=5), columns, 1024, 256)


def test_primitives_of_a_real_clip(real: Motion, columns) -> None:
    check_clip(real, columns, 768, 192)


def check_clip(motion: Motion, columns, n_window: int, n: int) -> None:
    rows, clip = Lodge().analyse(motion), columns(motion)
    stored = KeyMotion.from_rows(rows).minima
    before = digest(clip), digest(rows)
    n_filled = 0
    for start in range(0, len(clip) - n_window + 1, 96):
        window = clip[start : start + n_window]
        key = KeyMotion.from_rows(rows[start : start + n_window])
        cues = primitives(window, n_window, n, minima=key.minima, prominence=key.prominence)
        assert len(cues.frames) == 13
        assert cues.hard.tolist() == HARD_13
        assert cues.frames.dtype == np.float32
        check(cues, window, key.minima)
        soft = ~cues.hard & ~cues.filled
        nearest = np.abs(cues.start[soft][:, None] + 4 + start - stored).min(axis=1)
        assert (nearest <= 0.5).all()
        n_filled += int(cues.filled.sum())
        cues.frames[:] = 0  # the caller's own, no view of the window
    assert (digest(clip), digest(rows)) == before
    assert n_filled == 0  # both dances have enough minima: the loop above tested minima


def test_the_most_prominent_are_taken(dance, columns) -> None:
    window = columns(dance(256))
    minima, prominence = np.array([20, 60, 66, 100, 200]), np.array([0.1, 0.5, 0.4, 0.3, 0.2])
    cues = primitives(window, 256, 256, minima=minima, prominence=prominence)
    # 66 is the second in depth, but 6 frames from the first.
    assert (cues.start + 4).tolist() == [4, 60, 100, 252]
    assert cues.source == ("start", "minimum", "minimum", "end")


@pytest.mark.parametrize(
    ("minima", "centres"),
    [
        ([], [64, 128]),  # the middle, then the middle of the earlier half
        ([200], [100, 200]),
        ([60], [60, 158]),
        ([11], [64, 128]),  # 11 frames from the border are too few
        ([12], [12, 134]),
        ([244], [122, 244]),
        ([245], [64, 128]),
        ([100, 107], [100, 178]),  # 7 apart are too few; the deeper one is taken
        ([100, 108], [100, 108]),
    ],
)
def test_gaps_are_filled(minima: list[int], centres: list[int]) -> None:
    depth = -np.arange(len(minima), dtype=float)
    cues = primitives(np.zeros((256, 1)), 256, 256, minima=minima, prominence=depth)
    assert (cues.start + 4)[1:3].tolist() == centres
    assert cues.filled[1:3].tolist() == [c not in minima for c in centres]


def test_a_still_clip_is_filled(dance, columns) -> None:
    motion = dance(1024)
    still = Motion(
        np.repeat(motion.translation[:1], 1024, axis=0),
        np.repeat(motion.rotations[:1], 1024, axis=0),
        motion.grid,
        motion.skeleton,
    )
    assert Lodge().analyse(still)[:, 1:].max() == 0
    cues = primitives(columns(still))
    assert cues.filled.tolist() == [not hard for hard in HARD_13]
    assert (cues.start[1:3] + 4).tolist() == [64, 128]


def test_without_minima_the_windows_own_are_taken(dance, columns) -> None:
    motion = dance(1024)
    key = KeyMotion.from_rows(Lodge().analyse(motion))
    given_minima = primitives(columns(motion), minima=key.minima, prominence=key.prominence)
    assert primitives(columns(motion)).start.tolist() == given_minima.start.tolist()


@st.composite
def windows(draw: st.DrawFn) -> tuple[int, int, list[int], list[float]]:
    n, segments = draw(st.integers(48, 300)), draw(st.integers(1, 5))
    minima = sorted(draw(st.sets(st.integers(0, n * segments - 1), max_size=60)))
    # Few values, so that there are equals.
    depth = draw(st.lists(st.sampled_from([0.0, 0.1, 0.5, 1.0]), min_size=len(minima), max_size=len(minima)))
    return n, segments, minima, depth


@given(windows())
def test_every_window_has_its_primitives(case: tuple[int, int, list[int], list[float]]) -> None:
    n, segments, minima, depth = case
    window = np.arange(n * segments, dtype=np.float32)[:, None].repeat(2, axis=1)
    window.setflags(write=False)
    cues = primitives(window, n * segments, n, minima=np.array(minima, dtype=int), prominence=depth)
    check(cues, window, np.array(minima))
    again = primitives(window, n * segments, n, minima=np.array(minima, dtype=int), prominence=depth)
    assert again.start.tolist() == cues.start.tolist()
    for low in range(0, n * segments, n):
        room = [(d, m) for d, m in zip(depth, minima, strict=True) if low + 12 <= m <= low + n - 12]
        mine = (cues.start >= low) & (cues.start < low + n) & ~cues.hard
        taken = cues.start[mine & ~cues.filled] + 4
        if room:  # the deepest is never left out
            assert min(room, key=lambda pair: (-pair[0], pair[1]))[1] in taken
        if cues.filled[mine].any():  # filled only where no other minimum has room
            assert all(np.abs(taken - m).min(initial=99) < 8 for _, m in room)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"N": 512}, "N differs from the number of frames"),
        ({"n": 100}, "not a multiple of n"),
        ({"n": 32}, "too short for two soft cues"),
        ({"minima": [10]}, "must be given together"),
        ({"minima": [10], "prominence": []}, "invalid minima or prominence"),
        ({"minima": [10.0], "prominence": [0.1]}, "invalid minima or prominence"),
        ({"minima": [10, 256], "prominence": [0.1, 0.1]}, "ascending"),
        ({"minima": [10, 10], "prominence": [0.1, 0.1]}, "ascending"),
        ({"minima": [10], "prominence": [np.nan]}, "invalid prominence; found NaN"),
        ({"bias": 1}, "variant 'paper' has no bias"),
        ({"variant": "papr"}, "Did you mean 'paper'"),
        ({}, "lodge139"),
    ],
)
def test_what_does_not_fit(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        primitives(np.zeros((256, 10)), **({"N": 256, "n": 128} | arguments))


def test_borders() -> None:
    window = np.arange(512, dtype=np.float32).reshape(256, 2)
    before = digest(window)
    cut = borders(window)
    assert cut.shape == (8, 2)
    assert cut.dtype == np.float32
    np.testing.assert_array_equal(cut[:, 0] // 2, [0, 1, 2, 3, 252, 253, 254, 255])
    cut[:] = 0
    assert digest(window) == before
    # They are halves of the hard cues that a longer window shares with its neighbours.
    long = np.arange(2048.0).reshape(1024, 2)
    hard = primitives(long, minima=[], prominence=[])
    np.testing.assert_array_equal(borders(long[256:512])[:4], hard.frames[hard.hard][1][4:])
    np.testing.assert_array_equal(borders(long[256:512])[4:], hard.frames[hard.hard][2][:4])


@pytest.mark.parametrize("shape", [(7, 2), (256,), (2, 256, 2)])
def test_borders_of_no_window(shape: tuple[int, ...]) -> None:
    with raises_message(UsageError, "borders"):
        borders(np.zeros(shape))
