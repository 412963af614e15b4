"""librosa's compiled kernels: compiled by one process at a time."""

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.files.locks import file_lock

_RESAMPLING = ("librosa.core.audio", "librosa.util.utils")


@contextmanager
def compiling() -> Iterator[None]:
    """Let kernels of librosa be compiled within the context, which one process at a time enters."""
    load_librosa()  # here, not in `resample`, which would wait for the lock that this process holds
    with file_lock(_lock_file()):
        yield


def load_librosa() -> None:
    """Import the modules of librosa that `resample` uses under the same lock: that compiles kernels already.

    ``import librosa`` alone loads none of its modules.
    """
    if any(module not in sys.modules for module in _RESAMPLING):
        with file_lock(_lock_file()):
            for module in _RESAMPLING:
                import_module(module)


def _lock_file() -> Path:
    from dancedata.execution.cache import user_cache  # here, as plug-ins are listed without it

    name = f"kernels-{hashlib.sha256(sys.prefix.encode()).hexdigest()[:16]}.lock"
    temporary = Path(tempfile.gettempdir())
    try:
        folder = user_cache()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, UsageError):
        return temporary / name
    return (folder if os.access(folder, os.W_OK) else temporary) / name
