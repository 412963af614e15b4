"""Primitives as the paper describes them, and as Lodge's released code takes them."""

import hashlib
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.contacts.height import Height
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.datasets.finedance import FineDance
from dancedata.keymotion import Primitives, borders, primitives
from dancedata.keymotion.lodge import Lodge
from dancedata.keymotion.primitives_as_released import Key, key_frames, pieces
from dancedata.metrics.key_motion import KeyMotion
from dancedata.representations.lodge139 import Lodge139
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
def cases(draw: st.DrawFn) -> tuple[int, int, list[int], list[float]]:
    n, segments = draw(st.integers(48, 300)), draw(st.integers(1, 5))
    minima = sorted(draw(st.sets(st.integers(0, n * segments - 1), max_size=60)))
    # Few values, so that there are equals.
    depth = draw(st.lists(st.sampled_from([0.0, 0.1, 0.5, 1.0]), min_size=len(minima), max_size=len(minima)))
    return n, segments, minima, depth


@given(cases())
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


# ---- as Lodge's released code takes them


CLIPS = range(4)
SEGMENTS = (128, 256)


@pytest.fixture(scope="module")
def golden(peers: Any) -> Any:
    return peers.load("lodge_key_motion.npz")


@pytest.fixture(scope="module")
def windows(peers: Any, golden: Any) -> list[np.ndarray]:
    """Lodge's input: its own columns, or where only some of them exist, ours of the same motion."""
    sources = [source.split("+") for source in golden["clip_source"].tolist()]
    assert len(sources) == len(CLIPS)
    tracks = peers.load("lodge_mofea319.npz")
    if not peers.whole:
        reader = FineDance()
        refs = {ref.id: ref for ref in reader.scan(peers / "inputs" / "finedance").clips}
        tracks = {name: Lodge139().encode(reader.load(refs[name]), Height()) for name, _ in sources}
    return [tracks[track][int(start) : int(start) + 1024, :139] for track, start in sources]


@pytest.mark.parametrize("n", SEGMENTS)
@pytest.mark.parametrize("clip", CLIPS)
def test_key_motion(peers: Any, golden: Any, windows: list[np.ndarray], clip: int, n: int) -> None:
    window, key = windows[clip], f"L1024_fi{n}.key_motion"
    wanted, columns = golden[key][clip], golden.index(key, axis=2)
    before = hashlib.sha256(window.tobytes()).digest()
    cues = primitives(window, 1024, n, variant="code")
    assert (cues.start[~cues.hard] + 4).tolist() == golden[f"L1024_fi{n}.selected"][clip].tolist()
    # Equal for Lodge's own columns, within the gate of columns for ours.
    found = cues.frames.reshape(-1, 139)[:, columns]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0 if peers.whole else 1e-5)
    assert hashlib.sha256(window.tobytes()).digest() == before
    # Lodge wrote the frames of all pieces but the first into its batch.
    changed = np.zeros(1024, dtype=bool)
    changed[cues.start[1:, None] + np.arange(8)] = True
    np.testing.assert_array_equal(changed, golden[f"L1024_fi{n}.input_changed_frames"][clip])


def test_get_list(peers: Any) -> None:
    cases = json.loads((peers / "lodge_get_list_cases.json").read_text())
    assert len(cases) >= 10
    for case, wanted in cases.items():
        minima, count = case.split("|")
        assert [key.frame for key in key_frames(json.loads(minima), int(count), 1024)] == wanted, case


def test_the_first_gap_is_filled_where_all_are_narrow() -> None:
    assert [key.frame for key in key_frames([12, 20], 4, 32)] == [9, 10, 12, 20]


def test_sources_and_flags(windows: list[np.ndarray]) -> None:
    cues = primitives(windows[0], 1024, 256, variant="code")
    assert cues.source == ("start", *["minimum", "minimum", "border"] * 3, "minimum", "minimum", "end")
    assert cues.hard.tolist() == [True, False, False] * 4 + [True]
    # Inner hard cues lie at n i / K, within the first segment: not in the order of time.
    assert (cues.start[[3, 6, 9]] + 4).tolist() == [64, 128, 192]


@pytest.fixture
def window(dance, columns) -> np.ndarray:
    return columns(dance(1024))


def test_bias_shifts_all_but_the_first_and_last(window: np.ndarray) -> None:
    straight = primitives(window, variant="code").start
    for bias in range(-2, 3):
        shifted = primitives(window, variant="code", bias=bias).start
        assert (shifted - straight).tolist() == [0, *[bias] * 11, 0]


def test_a_generator_draws_the_bias(window: np.ndarray) -> None:
    part = window[:256]
    straight = primitives(part, 256, 128, variant="code").start[1]
    twice = []
    for _ in range(2):
        rng = np.random.default_rng(0)
        drawn = [primitives(part, 256, 128, variant="code", bias=rng).start[1] - straight for _ in range(25)]
        assert {int(bias) for bias in drawn} == {-2, -1, 0, 1, 2}
        twice.append(drawn)
    assert twice[0] == twice[1]


def test_a_piece_is_relative_to_its_first_frame(window: np.ndarray) -> None:
    cues = primitives(window, variant="code")
    assert (cues.frames[1:, 0][:, [4, 6]] == 0).all()
    np.testing.assert_array_equal(cues.frames[0], window[:8])
    rest = [j for j in range(139) if j not in (4, 6)]
    for cue, start in zip(cues.frames, cues.start, strict=True):
        np.testing.assert_array_equal(cue[:, rest], window[start : start + 8][:, rest])


def test_overlapping_pieces_see_earlier_writes() -> None:
    window = np.zeros((64, 7))
    window[:, 4] = np.arange(64.0)
    taken = pieces(window, [Key(12, False), Key(20, False)], 64, -2)
    assert taken.start.tolist() == [0, 6, 14, 56]
    # The first piece is a view until the first key is joined: its frames 6 and 7 are relative already.
    assert taken.frames[0][:, 4].tolist() == [0, 1, 2, 3, 4, 5, 0, 1]
    taken = pieces(window, [Key(30, False), Key(34, False)], 64, 0)
    assert taken.frames[0][:, 4].tolist() == list(range(8))
    # Frames 30 .. 33 were 4 .. 7 in the first key's piece, so the second begins at 4, not at 30.
    assert taken.frames[2][:, 4].tolist() == [0, 1, 2, 3, 30, 31, 32, 33]
    assert window[:, 4].tolist() == list(range(64))


def test_keys_near_the_ends_are_moved_inside() -> None:
    window = np.zeros((64, 7))
    assert pieces(window, [Key(3, False), Key(62, False)], 64, 0).start.tolist() == [0, 4, 52, 56]


@given(n=st.integers(16, 256), segments=st.integers(1, 4), bias=st.integers(-2, 2), data=st.data())
def test_any_window(n: int, segments: int, bias: int, data: st.DataObject) -> None:
    n_window = n * segments
    minima = sorted(data.draw(st.sets(st.integers(0, n_window - 2), max_size=80)))
    keys = key_frames(minima, 2 * segments, n_window)
    assert len(keys) == 2 * segments
    assert all(key.filled or key.frame in minima for key in keys)
    window = np.zeros((n_window, 7), dtype=np.float32)
    window.setflags(write=False)
    try:
        taken = pieces(window, keys, n, bias)
    except UsageError as error:
        # The first inner border is at n / K, which a small n puts before frame 4 - bias.
        assert n // segments < 4 - bias  # noqa: PT017
        assert "outside the window" in str(error)  # noqa: PT017
        return
    assert taken.frames.shape == (3 * segments + 1, 8, 7)


@pytest.mark.parametrize("bias", [3, -3, 0.5, "1"])
def test_unknown_bias(window: np.ndarray, bias: object) -> None:
    with raises_message(UsageError, "generator"):
        primitives(window, variant="code", bias=bias)


def test_it_takes_no_minima(window: np.ndarray) -> None:
    with raises_message(UsageError, "finds"):
        primitives(window, variant="code", minima=[100], prominence=[0.1])


def test_segments_too_short_for_the_slip(window: np.ndarray) -> None:
    with raises_message(UsageError, "piece"):
        primitives(window, 1024, 32, variant="code")
    with raises_message(UsageError, "short"):
        primitives(window[:8], 8, 8, variant="code")


def test_only_lodges_columns() -> None:
    with raises_message(UsageError, "minima"):
        primitives(np.zeros((1024, 151)), variant="code")
    with raises_message(DataError, "rotation", where="primitives, frame 0, pelvis", reason="bad_rotation"):
        primitives(np.zeros((1024, 139)), variant="code")
