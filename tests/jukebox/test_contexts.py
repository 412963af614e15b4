"""Cutting a song into contexts: every row once, codes and rows that meet, overlap as asked."""

import itertools
import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.audio.jukebox.feature import TAIL_S, contexts_of, unit_of
from dancedata.core.errors import UsageError
from tests.messages import raises_message

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
