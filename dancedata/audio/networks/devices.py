"""The devices that networks compute on: their cards, memory, batches, precision and exact products."""

import getpass
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import torch

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.files.locks import open_locked

#: This much of the free memory is left for the allocator's rounding and the libraries' work space.
RESERVE_BYTES = 512 << 20
#: Descriptors of the locks that this process holds.
_held: list[int] = []
Item = TypeVar("Item")
Result = TypeVar("Result")
_DTYPES = {"fp32": torch.float32, "fp16": torch.float16, "bf16": torch.bfloat16}
# By default cuBLAS may add up the parts of a long product in half precision.
_HALF_SUMS = {
    "allow_fp16_reduced_precision_reduction": False,
    "allow_bf16_reduced_precision_reduction": False,
    "allow_fp16_accumulation": False,
}


def require_device(device: str | torch.device | None) -> torch.device:
    """Return a device that exists; None is CUDA where there is a card, else the CPU."""
    if device is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        target = torch.device(device)
    except RuntimeError as error:
        raise UsageError("unknown device", found=device, allowed="cpu, cuda, cuda:1, ...") from error
    if target.type not in ("cpu", "cuda"):
        raise UsageError("unsupported device", found=device, allowed="cpu, cuda, cuda:1, ...")
    if target.type == "cuda" and (target.index or 0) >= torch.cuda.device_count():
        raise UsageError("the device does not exist", found=str(device),
                         allowed=f"cpu, or {torch.cuda.device_count()} cards")  # fmt: skip
    return target


def free_memory(device: torch.device) -> int | None:
    """Bytes that may be used on a CUDA device; None for other devices, whose memory is not accounted for."""
    if device.type != "cuda":
        return None
    # The driver does not count memory that torch caches, such as that of an earlier encoder, as free.
    torch.cuda.empty_cache()
    free, _total = torch.cuda.mem_get_info(device)
    return max(0, free - RESERVE_BYTES)


@lru_cache(maxsize=1)
def claimed(devices: tuple[str, ...]) -> str | None:
    """Return a card that no other process of this user on this machine uses, for the life of the process."""
    for device in devices:
        with suppress(OSError):
            # By the card itself: each job of a batch system counts its cards from 0.
            name = f"dancedata-{getpass.getuser()}-{torch.cuda.get_device_properties(device).uuid}.lock"
            lock = open_locked(Path(tempfile.gettempdir()) / name, wait=False)
            if lock is not None:
                _held.append(lock)
                return device
    return devices[0] if devices else None


class Batches:
    """Runs batches; keeps the largest size that the device has memory for.

    `fix`: What to do where a single item is too large, for the message.
    """

    def __init__(self, fix: str = "end other programs on the device") -> None:
        self.limit = sys.maxsize
        self.fix = fix

    def run(
        self, items: Sequence[Item], size: int, compute: Callable[[Sequence[Item]], list[Result]]
    ) -> Iterator[list[Result]]:
        """Compute items in order, `size` at once; the size is halved whenever the device runs out of memory."""
        if size < 1:
            raise UsageError("invalid value for batch_size", found=size, allowed="1 or more")
        start = 0
        while start < len(items):
            part = items[start : start + min(size, self.limit)]
            results = self._attempt(part, compute)
            if results is None:
                # Outside of the except block: the traceback of the error references the tensors of the batch.
                torch.cuda.empty_cache()
                continue
            start += len(part)
            yield results

    def _attempt(
        self, part: Sequence[Item], compute: Callable[[Sequence[Item]], list[Result]]
    ) -> list[Result] | None:
        """Compute one batch; if the device runs out of memory, lower the limit and return None."""
        try:
            return compute(part)
        except RuntimeError as error:
            if not _is_out_of_memory(error):
                raise
            if len(part) > 1:
                self.limit = len(part) // 2
                return None
            raise DanceDataError("the device has too little free memory for a single clip",
                                 found=str(error).split(". ")[0], fix=self.fix) from error  # fmt: skip


def _is_out_of_memory(error: RuntimeError) -> bool:
    """Whether torch, cuBLAS or cuDNN reports too little memory."""
    return isinstance(error, torch.cuda.OutOfMemoryError) or "_STATUS_ALLOC_FAILED" in str(error)


def resolve_precision(name: str, device: torch.device) -> str:
    """Return "fp32", "fp16" or "bf16"; "auto" is fp16 on CUDA and fp32 elsewhere."""
    if name not in ("auto", *_DTYPES):
        raise UsageError("unknown precision", found=name, allowed=", ".join(("auto", *_DTYPES)))
    if name == "auto":
        return "fp16" if device.type == "cuda" else "fp32"
    return name


def compute_dtype(precision: str) -> torch.dtype:
    """Return the type of factors and results of matrix products; sums, norms and softmax are always fp32."""
    return _DTYPES[precision]


@contextmanager
def exact_float32() -> Iterator[None]:
    """Compute fp32 products in fp32, and sum half-precision ones in fp32, under any settings of the program.

    Convolutions use TF32 by default on recent cards, which changes Jukebox's codes of about one clip in a hundred.
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
    before = getattr(owner, name)
    try:
        setattr(owner, name, value)
        yield
    finally:
        setattr(owner, name, before)
