"""In what precision the transformer computes, and plain fp32 where fp32 is meant."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Literal, get_args

import torch

from dancedata.core.errors import UsageError

PrecisionName = Literal["auto", "fp32", "fp16", "bf16"]

_DTYPES = {"fp32": torch.float32, "fp16": torch.float16, "bf16": torch.bfloat16}
# cuBLAS may add up the parts of a long product in half precision unless it is told not to.
_HALF_SUMS = {
    "allow_fp16_reduced_precision_reduction": False,
    "allow_bf16_reduced_precision_reduction": False,
    "allow_fp16_accumulation": False,
}


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
    """Compute fp32 products as fp32, and sum half-precision ones in fp32, whatever the program has set.

    Its settings are put back afterwards. Convolutions use TF32 by default on recent cards, which moves the codes of
    one clip in some hundred.
    """
    with ExitStack() as settings:
        matmul = torch.backends.cuda.matmul
        for name, value in _HALF_SUMS.items():
            if hasattr(matmul, name):
                settings.enter_context(_set(matmul, name, value))
        settings.enter_context(_exact_matmul())
        settings.enter_context(_exact_convolutions())
        yield


@contextmanager
def _exact_matmul() -> Iterator[None]:
    try:
        before = torch.get_float32_matmul_precision()
    except RuntimeError:
        # torch >= 2.9, and the program set one of the newer, per-backend switches.
        with _set(torch.backends.cuda.matmul, "fp32_precision", "ieee"):
            yield
        return
    if before == "highest":
        yield
        return
    try:
        torch.set_float32_matmul_precision("highest")
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@contextmanager
def _exact_convolutions() -> Iterator[None]:
    cudnn = torch.backends.cudnn
    if not hasattr(cudnn, "conv"):  # torch < 2.9
        with cudnn.flags(enabled=cudnn.enabled, benchmark=False, deterministic=True, allow_tf32=False):
            yield
        return
    # Not by `flags`: it leaves convolutions to the switch above it (torch.backends.fp32_precision), and cannot be
    # entered where the program treats convolutions and RNNs differently.
    with ExitStack() as settings:
        settings.enter_context(_set(cudnn, "benchmark", False))
        settings.enter_context(_set(cudnn, "deterministic", True))
        with suppress(RuntimeError):  # the old switch cannot be read where a newer one says otherwise
            settings.enter_context(_set(cudnn, "allow_tf32", False))
        # mkldnn is what computes on a CPU; it would take bf16 there.
        mkldnn: Any = torch.backends.mkldnn
        for kind in (cudnn.conv, cudnn.rnn, mkldnn.conv, mkldnn.matmul):
            settings.enter_context(_set(kind, "fp32_precision", "ieee"))
        yield


@contextmanager
def _set(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Set one of torch's switches for a while."""
    before = getattr(owner, name)
    try:
        setattr(owner, name, value)
        yield
    finally:
        setattr(owner, name, before)


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
