"""Columns and their mirror; the min-max scaler."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import SampleField
from dancedata.core.sample_steps import steps_of
from dancedata.store.normalize import Scaler
from tests.messages import raises_message

COLUMNS = Columns(
    (Group("contact", 2, "1", ("left", "right")), Group("root", 3, "m"), Group("beat", 1, "1")),
    Mirror((1, 0, 2, 3, 4, 5), (1, 1, -1, 1, 1, 1)),
)


def test_labels_and_slices() -> None:
    assert COLUMNS.width == 6
    assert COLUMNS.names == ("contact", "root", "beat")
    assert COLUMNS.labels == ("contact.left", "contact.right", "root.0", "root.1", "root.2", "beat")
    assert COLUMNS.slice("root") == slice(2, 5)
    with raises_message(UsageError, "contacts"):
        COLUMNS.slice("contacts")


def test_json_round_trip() -> None:
    assert Columns.from_json(json.loads(json.dumps(COLUMNS.to_json()))) == COLUMNS
    plain = Columns((Group("x", 3, "m"),))
    assert Columns.from_json(json.loads(json.dumps(plain.to_json()))) == plain


def test_mirror() -> None:
    x = np.arange(6, dtype=np.float32)
    assert COLUMNS.mirror is not None
    image = COLUMNS.mirror.apply(x)
    assert image.tolist() == [1, 0, -2, 3, 4, 5]
    assert image.dtype == np.float32
    assert COLUMNS.mirror.apply(np.zeros((2, 7, 6), np.float16)).dtype == np.float16
    assert x.tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    "mirror",
    [
        Mirror((0, 1), (1, 1)), Mirror((0, 0, 2), (1, 1, 1)), Mirror((0, 1, 2), (1, 1)), Mirror((0, 1, 2), (1, 0, 1)),
        Mirror((1, 2, 0), (1, 1, 1)), Mirror((1, 0, 2), (1, -1, 1)),
    ],
    ids=["width", "twice", "signs", "zero", "order 3", "unequal signs"],
)  # fmt: skip
def test_no_mirror(mirror: Mirror) -> None:
    with raises_message(UsageError, "columns"):
        Columns((Group("x", 3, "m"),), mirror)


@pytest.mark.parametrize(("width", "parts"), [(0, ()), (2, ("a",)), (1, ("a", "b"))])
def test_no_group(width: int, parts: tuple[str, ...]) -> None:
    with raises_message(UsageError, "width"):
        Group("x", width, "m", parts)


DATA = np.array([[0.0, 5.0, -1.0, 0.1], [4.0, 5.0, 3.0, 0.1 + 1e-7], [1.0, 5.0, 0.0, 0.1]])


def test_scaler_is_scikit_learns() -> None:
    """MinMaxScaler(feature_range=(-1, 1)): scale = 2 / range, offset = -1 - min * scale; range 1 if constant."""
    scaler = Scaler("minmax", DATA.min(axis=0), DATA.max(axis=0))
    np.testing.assert_allclose(scaler.scale, [0.5, 2, 0.5, 2])
    np.testing.assert_allclose(scaler.offset, [-1, -11, -0.5, -1.2])
    scaled = scaler.normalize(DATA)
    np.testing.assert_allclose(scaled[:, :3], [[-1, -1, -1], [1, -1, 1], [-0.5, -1, -0.5]])
    np.testing.assert_allclose(scaled[:, 3], -1, atol=1e-6)
    np.testing.assert_allclose(scaler.unnormalize(scaled), DATA, atol=1e-12)


def test_range_at_the_limit_of_constant() -> None:
    limit = 10 * 1.1920929e-07
    scale = Scaler("minmax", [0.0, 0.0], [limit * 0.99, limit * 1.01]).scale
    np.testing.assert_allclose(scale, [2, 2 / (limit * 1.01)])


def test_clipping() -> None:
    scaler = Scaler("minmax", [0.0], [2.0])
    x = np.array([[-1.0], [3.0], [1.0]], np.float32)
    assert scaler.normalize(x, clamp=True).ravel().tolist() == [-1, 1, 0]
    assert scaler.normalize(x).ravel().tolist() == [-2, 2, 0]
    assert scaler.unnormalize(np.array([[2.0], [-3.0]])).ravel().tolist() == [3, -2]
    assert scaler.unnormalize(np.array([[2.0], [-3.0]]), clamp=True).ravel().tolist() == [2, 0]
    assert x.ravel().tolist() == [-1, 3, 1]
    assert scaler.normalize(x).dtype == np.float32
    assert scaler.normalize(np.array([[1]])).dtype == np.float64


@settings(deadline=None)
@given(st.integers(0, 999))
def test_mirrored_range_covers_both(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(20, 6)) * [1, 2, 3, 4, 5, 0]
    assert COLUMNS.mirror is not None
    field = SampleField("f", "motion", COLUMNS, FrameGrid(30))
    scaler = Scaler("minmax", x.min(axis=0), x.max(axis=0)).covering(field, steps_of(["mirror"]))
    both = np.concatenate([x, COLUMNS.mirror.apply(x)])
    np.testing.assert_array_equal(scaler.data_min, both.min(axis=0))
    np.testing.assert_array_equal(scaler.data_max, both.max(axis=0))


def test_wrong_widths() -> None:
    scaler = Scaler("minmax", DATA.min(axis=0), DATA.max(axis=0))
    assert scaler.width == 4
    with raises_message(UsageError, "width"):
        scaler.normalize(np.zeros((2, 5)))
    with raises_message(UsageError, "data_min"):
        Scaler("minmax", [0.0], [1.0, 2.0])


def test_a_scaler_file_comes_back(tmp_path: Path) -> None:
    known = {"field": "f", "columns": list("abcd"), "dataset": "d" * 64}
    scaler = Scaler("minmax", DATA.min(axis=0), DATA.max(axis=0), dtype="float16", **known)
    scaler.save(tmp_path / "scaler.json")
    back = Scaler.load(tmp_path / "scaler.json")
    for name in ("scale", "offset", "data_min", "data_max"):
        np.testing.assert_array_equal(getattr(back, name), getattr(scaler, name))
    assert {"field": back.field, "columns": list(back.columns), "dataset": back.dataset} == known
    assert (back.kind, back.dtype, back.sha256) == ("minmax", np.float16, scaler.sha256)


@pytest.mark.parametrize(
    "change",
    [
        {"scaler": 2}, {"scaler": True}, {"field": 1}, {"columns": ["a"]}, {"columns": [1] * 4}, {"dataset": None},
        {"dtype": "float64"}, {"data_min": [0] * 4}, {"data_min": [True] * 4}, {"data_max": ["1"] * 4},
        {"data_max": [-1e9] * 4}, {"data_max": [1e300] * 4}, {"data_max": 1}, {"more": 1}, {"sha256": ""},
    ],
)  # fmt: skip
def test_a_changed_scaler_file_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    path = tmp_path / "scaler.json"
    Scaler("minmax", DATA.min(axis=0), DATA.max(axis=0), columns=list("abcd")).save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with raises_message(UsageError, r"scaler\.save", where="scaler.json"):
        Scaler.load(path)


def test_no_scaler_file(tmp_path: Path) -> None:
    path = tmp_path / "scaler.json"
    for text in ("", "[]", "nan", '{"scaler": 1}', "[" * 100_000):
        path.write_text(text)
        with pytest.raises(UsageError, match="not a scaler file"):
            Scaler.load(path)
    for missing in (tmp_path, tmp_path / "gone.json"):
        with pytest.raises(UsageError, match="not a scaler file"):
            Scaler.load(missing)


# Ranges of columns as encoders have them, stored as float16: wide, narrow, far from 0, a step apart, constant.
HALF = np.array([[-2, 0.3, 100, 1, 1e-4, 0], [3, 0.3004, 140, 1.001, 1.2e-4, 0]], np.float16)


def test_half_precision_is_computed_in_float32() -> None:
    rng = np.random.default_rng(0)
    wide = np.array([[0.001, -4.0], [0.00103, 4.0]], np.float16)
    rows = (wide[0] + rng.uniform(0, 1, (200, 2)) * (wide[1].astype(np.float64) - wide[0])).astype(np.float16)
    scaler = Scaler("minmax", rows.min(axis=0), rows.max(axis=0), dtype=np.float16)
    exact = rows.astype(np.float64)
    low, high = exact.min(axis=0), exact.max(axis=0)
    wanted = 2 * (exact - low) / (high - low) - 1
    found = scaler.normalize(rows)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-5)
    np.testing.assert_allclose(scaler.unnormalize(found), exact, rtol=0, atol=1e-6)


def test_constant_columns_are_judged_by_the_stored_type() -> None:
    half, single = (Scaler("minmax", HALF[0], HALF[1], dtype=dtype) for dtype in (np.float16, np.float32))
    np.testing.assert_array_equal(half.scale == 2, [False, True, False, True, False, True])
    np.testing.assert_array_equal(single.scale == 2, [False, False, False, False, False, True])
    assert np.isfinite(half.normalize(HALF)).all()
    assert np.abs(half.normalize(HALF)).max() <= 1 + 1e-4


@pytest.mark.parametrize("name", ["float16", "bfloat16", "float32"])
def test_types_of_torch(name: str) -> None:
    torch = pytest.importorskip("torch")
    scaler = Scaler("minmax", [-0.2, 3.0], [0.1, 3.5])
    x = torch.rand(50, 2).to(getattr(torch, name)) * 2 - 1
    low, high = scaler.data_min, scaler.data_max
    wanted = low + (x.double().numpy() + 1) / 2 * (high - low)
    for clip in (False, True):
        found = scaler.unnormalize(x, clamp=clip)
        assert found.dtype == torch.float32
        np.testing.assert_allclose(found.numpy(), wanted, rtol=0, atol=1e-6)
        assert scaler.normalize(x, clamp=clip).dtype == torch.float32
    assert scaler.normalize(torch.zeros(1, 2, dtype=torch.int64)).tolist() == [pytest.approx([1 / 3, -13.0])]
