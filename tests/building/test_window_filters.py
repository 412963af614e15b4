"""Window filters that are not the movement filter, at building and at reading; windows of a song."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

import dancedata
from dancedata.building.fields.music import MusicField
from dancedata.building.plan import make_plan
from dancedata.core.clip import Reject
from dancedata.core.columns import Columns
from dancedata.core.errors import RecipeError, UsageError
from dancedata.core.grid import FrameGrid, WindowGrid, WindowSpec
from dancedata.core.plugins import WindowFilter
from dancedata.core.registry import FILTERS
from dancedata.recipes.parse import load_recipe
from tests.messages import raises_message


@dataclass(frozen=True)
class Minima(WindowFilter):
    """Keeps windows with key motions.

    least : number of minima that a window has at least.
    field : key motion field.
    """

    version: ClassVar[int] = 1

    least: int = 1
    field: str = "lodge"

    def check(self, columns: Columns) -> None:
        columns.slice("minimum")

    def reject(self, rows: Any, columns: Columns, grid: FrameGrid) -> Reject | None:
        assert not rows.flags.writeable
        n = int(rows[:, columns.slice("minimum")].sum())
        detail = f"{n} minima at {grid} per second"
        return None if n >= self.least else Reject(self.reason, detail=detail, numbers={"minima": n})


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    FILTERS.names()
    monkeypatch.setattr(FILTERS, "_classes", dict(FILTERS._classes))
    FILTERS.register("minima")(Minima)


SMALL = ("audio={}", "keymotion=lodge", "windows.length_s=1", "windows.stride_s=0.5")


def test_any_filter_at_building_and_at_reading(corpus: Path, run_build, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from dancedata.torch import Select, WindowDataset

    run_build(corpus, tmp_path / "all", "aist++", SMALL)
    everything = dancedata.open(tmp_path / "all")
    minima = everything.fields["lodge"].slice("minimum")
    counts = {
        (w.clip, w.start): int(everything.read(w, "lodge")[:, minima].sum()) for w in everything.windows("train")
    }
    least = sorted(counts.values())[len(counts) // 2] + 1
    few = {window for window, n in counts.items() if n < least}
    assert 0 < len(few) < len(counts)
    run_build(corpus, tmp_path / "out", "aist++", (*SMALL, f"rules.minima.least={least}"), strict=True)
    store = dancedata.open(tmp_path / "out")
    rejects = [r for r in store.rejects if r["reason"] == "filtered"]
    assert {(r["clip"], r["window"]) for r in rejects if "window" in r} == few
    assert {(w.clip, w.start) for w in store.windows("train")} == counts.keys() - few
    assert rejects[0]["detail"].endswith("minima at 30 per second")
    # A clip of which no window is left is one reject more.
    lost = {clip for clip, _ in counts} - {clip for clip, start in counts if (clip, start) not in few}
    assert {r["clip"] for r in rejects if "window" not in r} == lost
    for asked in ({"minima": {"least": least}}, Minima(least)):
        read = WindowDataset(everything, fields=("edge151",), select=Select(filter=asked), scale=None)
        assert {(r.clip, r.window) for r in read.rejects} == few
        assert {r.reason for r in read.rejects} == {"filtered"}
    with raises_message(UsageError, "rotation_6d"):
        WindowDataset(everything, fields=("edge151",), select=Select(filter=Minima(field="edge151")))
    notes = make_plan(load_recipe("aist++", (*SMALL, "rules=minima")), corpus).to_json()["notes"]
    assert any("before minima" in note for note in notes)


def test_filters_in_recipes() -> None:
    recipe = load_recipe("aist++", (*SMALL, "rules=minima"))
    assert recipe.document["rules"] == {"minima": {"least": 1, "field": "lodge"}}
    for wrong in (
        "{minim: {}}", "[minima]", "{minima: {field: lodg}}", "{minima: {field: edge151}}",
    ):  # fmt: skip
        with raises_message(RecipeError, "problem", where="aist++"):
            load_recipe("aist++", (*SMALL, f"rules={wrong}"))


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
