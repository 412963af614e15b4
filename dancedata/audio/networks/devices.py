"""The devices to compute on, and the card that a worker process takes."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from dancedata.core.errors import UsageError
from dancedata.core.locks import open_locked

if TYPE_CHECKING:
    import torch

#: This much of the free memory is left for the allocator's rounding and the libraries' work space.
RESERVE_BYTES = 512 << 20
#: Descriptors of the locks that this process holds.
_held: list[int] = []


def require_device(device: str | torch.device | None) -> torch.device:
    """Return a device that exists; None is CUDA where there is a card, else the CPU."""
    import torch

    if device is None:
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        target = torch.device(device)
    except RuntimeError as error:
        raise UsageError("unknown device", found=device, allowed="cpu, cuda, cuda:1, ...") from error
    if target.type not in ("cpu", "cuda"):
        raise UsageError("unsupported device", found=device, allowed="cpu, cuda, cuda:1, ...")
    if target.type == "cuda" and (target.index or 0) >= torch.cuda.device_count():
        raise UsageError(
            "the device does not exist",
            found=str(device),
            allowed=f"cpu, or {torch.cuda.device_count()} cards",
        )
    return target


def free_memory(device: torch.device) -> int | None:
    """Bytes that may be used on a CUDA device; None for other devices, whose memory is not accounted for."""
    if device.type != "cuda":
        return None
    import torch

    # The driver does not count memory that torch caches, such as that of an earlier encoder, as free.
    torch.cuda.empty_cache()
    free, _total = torch.cuda.mem_get_info(device)
    return max(0, free - RESERVE_BYTES)


@lru_cache(maxsize=1)
def claimed(devices: tuple[str, ...]) -> str | None:
    """Return a card that no other process of this user on this machine uses, for the life of the process.

    If all cards are in use, the first one, which is then shared; None without cards.
    """
    for device in devices:
        with suppress(OSError):
            lock = open_locked(Path(tempfile.gettempdir()) / f"dancedata-{_user()}-{_card(device)}.lock", wait=False)
            if lock is not None:
                _held.append(lock)
                return device
    return devices[0] if devices else None


def _card(device: str) -> str:
    """Return a name of the card itself: each job of a batch system counts its cards from 0."""
    import torch

    # torch < 2.5 has no uuid: the number is used instead.
    return str(getattr(torch.cuda.get_device_properties(device), "uuid", device.replace(":", "-")))


def _user() -> str:
    import getpass

    return getpass.getuser()
