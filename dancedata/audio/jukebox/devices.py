"""Which card a worker process computes on."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

_held: list[Any] = []


@lru_cache(maxsize=1)
def claimed(devices: tuple[str, ...]) -> str | None:
    """Return a card that no other process of this user on this machine computes on, for the life of the process.

    Where all are taken, the first one: it is shared. None if there are none.
    """
    from filelock import FileLock, Timeout

    for device in devices:
        lock = FileLock(Path(tempfile.gettempdir()) / f"dancedata-{_user()}-{_card(device)}.lock", timeout=0)
        try:
            lock.acquire()
        except (Timeout, OSError):
            continue
        _held.append(lock)
        return device
    return devices[0] if devices else None


def _card(device: str) -> str:
    """Return a name of the card itself: numbers begin anew in every job of a batch system."""
    import torch

    # Without an identity (torch < 2.5) the number has to do.
    return str(getattr(torch.cuda.get_device_properties(device), "uuid", device.replace(":", "-")))


def _user() -> str:
    import getpass

    return getpass.getuser()
