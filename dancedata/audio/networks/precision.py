"""The precision that networks compute in, and exact fp32 products."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Literal, get_args

import torch

from dancedata.core.errors import UsageError

PrecisionName = Literal["auto", "fp32", "fp16", "bf16"]

_DTYPES = {"fp32": torch.float32, "fp16": torch.float16, "bf16": torch.bfloat16}
# By default cuBLAS may add up the parts of a long product in half precision.
_HALF_SUMS = {
    "allow_fp16_reduced_precision_reduction": False,
    "allow_bf16_reduced_precision_reduction": False,
    "allow_fp16_accumulation": False,
}


def resolve_precision(name: str, device: torch.device) -> str:
    """Return "fp32", "fp16" or "bf16"; "auto" is fp16 on CUDA and fp32 elsewhere."""
    if name not in get_args(PrecisionName):
        raise UsageError("unknown precision", found=name, allowed=", ".join(get_args(PrecisionName)))
    if name == "auto":
        return "fp16" if device.type == "cuda" else "fp32"
    return name


def compute_dtype(precision: str) -> torch.dtype:
    """Return the type of factors and results of matrix products; sums, norms and softmax are always fp32."""
    return _DTYPES[precision]


@contextmanager
def exact_float32() -> Iterator[None]:
    """Compute fp32 products in fp32, and sum half-precision ones in fp32, whatever the program's settings.

    The settings are restored afterwards. Convolutions use TF32 by default on recent cards, which changes Jukebox's
    codes of about one clip in a hundred.
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
        # torch >= 2.9, and the program has set one of the newer switches per backend.
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
    # Not by `flags`: it leaves convolutions to the general switch (torch.backends.fp32_precision), and cannot be
    # entered if the program's settings of convolutions and RNNs differ.
    with ExitStack() as settings:
        settings.enter_context(_set(cudnn, "benchmark", False))
        settings.enter_context(_set(cudnn, "deterministic", True))
        with suppress(RuntimeError):  # the old switch cannot be read if a newer one differs
            settings.enter_context(_set(cudnn, "allow_tf32", False))
        # mkldnn computes on a CPU and might use bf16.
        mkldnn: Any = torch.backends.mkldnn
        for kind in (cudnn.conv, cudnn.rnn, mkldnn.conv, mkldnn.matmul):
            settings.enter_context(_set(kind, "fp32_precision", "ieee"))
        yield


@contextmanager
def _set(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Set one of torch's switches within the context."""
    before = getattr(owner, name)
    try:
        setattr(owner, name, value)
        yield
    finally:
        setattr(owner, name, before)
