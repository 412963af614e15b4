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


@contextmanager
def compiling() -> Iterator[None]:
    """Let kernels of librosa be compiled within the context, which one process at a time enters."""
    with file_lock(_lock_file()):
        # These compile kernels at import; `import librosa` alone loads none of its modules.
        for module in ("librosa.core.audio", "librosa.util.utils"):
            import_module(module)
        yield


def _lock_file() -> Path:
    from dancedata.execution.cache import user_cache  # here: listing plug-ins does not need it

    name = f"kernels-{hashlib.sha256(sys.prefix.encode()).hexdigest()[:16]}.lock"
    temporary = Path(tempfile.gettempdir())
    try:
        folder = user_cache()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, UsageError):
        return temporary / name
    return (folder if os.access(folder, os.W_OK) else temporary) / name
