"""In what precision the transformer computes, and plain fp32 where fp32 is meant."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, get_args

import torch

from dancedata.core.errors import UsageError

PrecisionName = Literal["auto", "fp32", "fp16", "bf16"]

_DTYPES = {"fp32": torch.float32, "fp16": torch.float16, "bf16": torch.bfloat16}


def resolve_precision(name: str, device: torch.device) -> str:
    """Return "fp32", "fp16" or "bf16"; "auto" is fp16 on CUDA and fp32 elsewhere."""
    if name not in get_args(PrecisionName):
        raise UsageError("jukebox: unknown precision", found=name, allowed=", ".join(get_args(PrecisionName)))
    if name == "auto":
        return "fp16" if device.type == "cuda" else "fp32"
    return name


def compute_dtype(precision: str) -> torch.dtype:
    """Type of what goes into and comes out of matrix products; sums, norms and softmax are always fp32."""
    return _DTYPES[precision]


@contextmanager
def exact_float32() -> Iterator[None]:
    """Compute fp32 products as fp32, whatever TF32 setting the program has; it is put back afterwards.

    Convolutions use TF32 by default on recent cards, which moves the codes of one clip in some hundred.
    """
    matmul = torch.backends.cuda.matmul
    cudnn = torch.backends.cudnn
    try:
        legacy = torch.get_float32_matmul_precision()
    except RuntimeError:
        # torch >= 2.9, and the program set the newer, per-backend switch.
        legacy = ""
    backend = "" if legacy else matmul.fp32_precision
    with cudnn.flags(enabled=cudnn.enabled, benchmark=False, deterministic=True, allow_tf32=False):
        try:
            if backend:
                matmul.fp32_precision = "ieee"
            elif legacy != "highest":
                torch.set_float32_matmul_precision("highest")
            yield
        finally:
            if backend:
                matmul.fp32_precision = backend
            elif legacy != "highest":
                torch.set_float32_matmul_precision(legacy)


def product(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0) -> torch.Tensor:
    """Linear layer alpha * (x @ weight) + bias, rounded to the type of x; sums in fp32.

    Parameters
    ----------
    x
        (N, in).
    weight
        (in, out), of any floating type: weights that are stored in fp16 stay so in memory, and are cast a product
        at a time.
    bias
        (out,).
    """
    if x.device.type == "cpu" and x.dtype != torch.float32:
        # CPUs without half-precision units take 75 times as long; a product of exactly representable factors,
        # summed in fp32 and rounded once, is also what a GPU's tensor cores give.
        return torch.addmm(bias.float(), x.float(), weight.float(), alpha=alpha).to(x.dtype)
    return torch.addmm(bias, x, weight.to(x.dtype), alpha=alpha)


def add_product(
    total: torch.Tensor, x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *, alpha: float = 1.0
) -> None:
    """Add a linear layer to the fp32 residual stream `total` (N, out), in place; the rest as `product`."""
    if x.dtype == torch.float32:
        total.addmm_(x, weight.float(), alpha=alpha).add_(bias)
    else:
        total.add_(product(x, weight, bias, alpha=alpha))
