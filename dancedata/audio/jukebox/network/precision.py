"""Linear layers in the precision of the transformer, with sums in fp32."""

from __future__ import annotations

import torch


def product(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0) -> torch.Tensor:
    """Linear layer alpha * (x @ weight) + bias, rounded to the type of x; sums in fp32.

    Parameters
    ----------
    x
        (N, in).
    weight
        (in, out), of any floating type: weights stored in fp16 stay in fp16 in memory, and are cast for each product.
    bias
        (out,).
    """
    if x.device.type == "cpu" and x.dtype != torch.float32:
        # CPUs without half-precision units take 75 times as long. The tensor cores of GPUs compute the same:
        # products of exactly representable factors, summed in fp32 and rounded once.
        return torch.addmm(bias.float(), x.float(), weight.float(), alpha=alpha).to(x.dtype)
    return torch.addmm(bias, x, weight.to(x.dtype), alpha=alpha)


def add_product(
    total: torch.Tensor, x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0
) -> None:
    """Add a linear layer to the fp32 residual stream `total` (N, out), in place; otherwise as `product`."""
    if x.dtype == torch.float32:
        total.addmm_(x, weight.float(), alpha=alpha).add_(bias)
    else:
        total.add_(product(x, weight, bias, alpha=alpha))
