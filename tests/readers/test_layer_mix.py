"""The learned sum of stored layers."""

import pytest
import torch

from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.readers import LayerMix
from tests.messages import raises_message


def columns(*widths: int, name: str = "layer") -> Columns:
    return Columns(tuple(Group(f"{name}{k}", width, "1") for k, width in enumerate(widths)))


def test_it_begins_as_the_mean_and_sums_by_softmax() -> None:
    rows = torch.randn(4, 7, 3 * 5, generator=torch.Generator().manual_seed(0))
    mix = LayerMix(columns(5, 5, 5))
    layers = [rows[..., :5], rows[..., 5:10], rows[..., 10:]]
    assert torch.allclose(mix(rows), sum(layers) / 3, atol=1e-6)
    with torch.no_grad():
        mix.weights.copy_(torch.tensor([0.0, 1.0, -1.0]))
        mix.scale.fill_(3.0)  # type: ignore[union-attr, operator]
    weights = torch.tensor([1.0, 2.718281828, 0.367879441])
    expected = 3 * sum(w * layer for w, layer in zip(weights / weights.sum(), layers, strict=True))
    assert torch.allclose(mix(rows), expected, atol=1e-5)
    assert mix(rows.half()).dtype == torch.float16


def test_parameters_and_gradients() -> None:
    assert {name for name, _ in LayerMix(columns(5, 5)).named_parameters()} == {"weights", "scale"}
    plain = LayerMix(columns(5, 5), scaled=False)
    plain(torch.tensor([[1.0] * 5 + [2.0] * 5])).sum().backward()
    assert {name for name, _ in plain.named_parameters()} == {"weights"}
    assert plain.weights.grad.tolist() == [-1.25, 1.25]  # type: ignore[union-attr]


def test_layers_of_different_size_are_normalised() -> None:
    layer = torch.tensor([1.0, 2.0, 3.0])
    rows = torch.cat((layer, 1000 * layer))
    alike = LayerMix(columns(3, 3), normalize=True)(rows)
    assert torch.allclose(alike, (layer - 2) / (2 / 3) ** 0.5, atol=1e-4)


@pytest.mark.parametrize("wrong", [columns(5), columns(5, 4), columns(5, 5, name="other")])
def test_columns_that_are_not_layers(wrong: Columns) -> None:
    with raises_message(UsageError, "encoder"):
        LayerMix(wrong)
