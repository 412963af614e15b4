"""Windows of a song: whole numbers of samples, each at its own exact time."""

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from dancedata.building.fields.music import MusicField
from dancedata.core.grid import FrameGrid, WindowGrid, WindowSpec

RATES = ["30", "29.97", "30000/1001", "60", "25", "1/7", "997/13"]


@given(
    st.sampled_from(RATES).map(FrameGrid.of), st.builds(WindowGrid, st.integers(1, 40), st.integers(1, 20)),
    st.sampled_from([7, 50, 997, 8000]), st.integers(0, 9000),
)  # fmt: skip
def test_windows_are_those_with_all_their_samples(grid: FrameGrid, windows: WindowGrid, rate: int, n: int) -> None:
    feature: Any = SimpleNamespace()
    field = MusicField("f", grid, feature, windows=WindowSpec(windows.length, windows.stride, grid))
    starts, length = field.slices(n, rate)
    stride = windows.stride / grid.rate * rate
    assert length == int(windows.length / grid.rate * rate)
    expected = []
    while length and len(expected) < 30 and int(len(expected) * stride) + length <= n:
        expected.append(int(len(expected) * stride))
    assert starts[:30].tolist() == expected
    if len(starts):
        assert starts[-1] + length <= n < int(len(starts) * Fraction(stride)) + length
