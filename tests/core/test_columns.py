"""Columns and their mirror; the min-max scaler."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.normalize import MinMax

COLUMNS = Columns(
    (Group("contact", 2, "1", ("left", "right")), Group("root", 3, "m"), Group("beat", 1, "1")),
    Mirror((1, 0, 2, 3, 4, 5), (1, 1, -1, 1, 1, 1)),
)


def test_labels_and_slices() -> None:
    assert COLUMNS.width == 6
    assert COLUMNS.names == ("contact", "root", "beat")
    assert COLUMNS.labels == ("contact.left", "contact.right", "root.0", "root.1", "root.2", "beat")
    assert COLUMNS.slice("root") == slice(2, 5)
    with pytest.raises(UsageError, match="Did you mean 'contact'"):
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


@given(st.integers(0, 999))
def test_mirror_twice_is_the_same(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(3, 4, 6))
    assert COLUMNS.mirror is not None
    np.testing.assert_array_equal(COLUMNS.mirror.apply(COLUMNS.mirror.apply(x)), x)


@pytest.mark.parametrize(
    "mirror",
    [
        Mirror((0, 1), (1, 1)),
        Mirror((0, 0, 2), (1, 1, 1)),
        Mirror((0, 1, 2), (1, 1)),
        Mirror((0, 1, 2), (1, 0, 1)),
        Mirror((1, 2, 0), (1, 1, 1)),
        Mirror((1, 0, 2), (1, -1, 1)),
    ],
    ids=["width", "twice", "signs", "zero", "order 3", "unequal signs"],
)
def test_no_mirror(mirror: Mirror) -> None:
    with pytest.raises(UsageError, match="mirror"):
        Columns((Group("x", 3, "m"),), mirror)


@pytest.mark.parametrize(("width", "parts"), [(0, ()), (2, ("a",)), (1, ("a", "b"))])
def test_no_group(width: int, parts: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="'x'"):
        Group("x", width, "m", parts)


DATA = np.array([[0.0, 5.0, -1.0, 0.1], [4.0, 5.0, 3.0, 0.1 + 1e-7], [1.0, 5.0, 0.0, 0.1]])


def test_scaler_is_scikit_learns() -> None:
    """MinMaxScaler(feature_range=(-1, 1)): scale = 2 / range, offset = -1 - min * scale; range 1 if constant."""
    scaler = MinMax(DATA.min(axis=0), DATA.max(axis=0))
    np.testing.assert_allclose(scaler.scale, [0.5, 2, 0.5, 2])
    np.testing.assert_allclose(scaler.offset, [-1, -11, -0.5, -1.2])
    scaled = scaler.normalize(DATA)
    np.testing.assert_allclose(scaled[:, :3], [[-1, -1, -1], [1, -1, 1], [-0.5, -1, -0.5]])
    np.testing.assert_allclose(scaled[:, 3], -1, atol=1e-6)
    np.testing.assert_allclose(scaler.unnormalize(scaled), DATA, atol=1e-12)


def test_range_at_the_limit_of_constant() -> None:
    limit = 10 * 1.1920929e-07
    scale = MinMax([0.0, 0.0], [limit * 0.99, limit * 1.01]).scale
    np.testing.assert_allclose(scale, [2, 2 / (limit * 1.01)])


def test_clipping() -> None:
    scaler = MinMax([0.0], [2.0])
    x = np.array([[-1.0], [3.0], [1.0]], np.float32)
    assert scaler.normalize(x).ravel().tolist() == [-1, 1, 0]
    assert scaler.normalize(x, clip=False).ravel().tolist() == [-2, 2, 0]
    assert scaler.unnormalize(np.array([[2.0], [-3.0]])).ravel().tolist() == [3, -2]
    assert scaler.unnormalize(np.array([[2.0], [-3.0]]), clip=True).ravel().tolist() == [2, 0]
    assert x.ravel().tolist() == [-1, 3, 1]
    assert scaler.normalize(x).dtype == np.float32
    assert scaler.normalize(np.array([[1]])).dtype == np.float64


def test_torch() -> None:
    torch = pytest.importorskip("torch")
    scaler = MinMax(DATA.min(axis=0), DATA.max(axis=0))
    x = np.random.default_rng(0).normal(size=(2, 5, 4)).astype(np.float32)
    for clip in (True, False):
        made = scaler.normalize(torch.from_numpy(x), clip=clip)
        assert made.dtype == torch.float32
        np.testing.assert_allclose(made.numpy(), scaler.normalize(x, clip=clip), rtol=1e-6)
        back = scaler.unnormalize(made, clip=clip)
        np.testing.assert_allclose(back.numpy(), scaler.unnormalize(made.numpy(), clip=clip), rtol=1e-5, atol=1e-6)


@settings(deadline=None)
@given(st.integers(0, 999))
def test_mirrored_range_covers_both(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(20, 6)) * [1, 2, 3, 4, 5, 0]
    assert COLUMNS.mirror is not None
    scaler = MinMax(x.min(axis=0), x.max(axis=0)).with_mirror(COLUMNS.mirror)
    both = np.concatenate([x, COLUMNS.mirror.apply(x)])
    np.testing.assert_array_equal(scaler.data_min, both.min(axis=0))
    np.testing.assert_array_equal(scaler.data_max, both.max(axis=0))


def test_state_and_wrong_widths() -> None:
    scaler = MinMax(DATA.min(axis=0), DATA.max(axis=0))
    back = MinMax.from_state(json.loads(json.dumps(scaler.state_dict())))
    np.testing.assert_array_equal(back.scale, scaler.scale)
    np.testing.assert_array_equal(back.offset, scaler.offset)
    assert scaler.width == 4
    with pytest.raises(UsageError, match="5 columns"):
        scaler.normalize(np.zeros((2, 5)))
    with pytest.raises(UsageError, match="one minimum"):
        MinMax([0.0], [1.0, 2.0])
