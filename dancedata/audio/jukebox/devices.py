"""Which card a worker process computes on."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from dancedata.core.locks import open_locked

#: Descriptors of the locks that this process holds.
_held: list[int] = []


@lru_cache(maxsize=1)
def claimed(devices: tuple[str, ...]) -> str | None:
    """Return a card that no other process of this user on this machine computes on, for the life of the process.

    Where all are taken, the first one: it is shared. None if there are none.
    """
    for device in devices:
        with suppress(OSError):
            lock = open_locked(Path(tempfile.gettempdir()) / f"dancedata-{_user()}-{_card(device)}.lock", wait=False)
            if lock is not None:
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
