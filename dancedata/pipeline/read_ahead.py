"""Decodes the next song while a device computes."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError

_threads: list[ThreadPoolExecutor] = []
_ahead: dict[Path, Future[AudioSignal]] = {}


def read_ahead(path: Path) -> None:
    """Begin to decode a file in another thread; forgets files that were begun and not asked for."""
    if not _threads:
        _threads.append(ThreadPoolExecutor(max_workers=1, thread_name_prefix="read-ahead"))
    if path not in _ahead:
        _ahead.clear()
        from dancedata.audio.signal import load_audio

        _ahead[path] = _threads[0].submit(load_audio, path)


def decoded(path: Path) -> AudioSignal:
    """Return a file's signal, decoded now or ahead.

    Raises
    ------
    DataError
        As `load_audio`.
    """
    from dancedata.audio.signal import load_audio

    begun = _ahead.pop(path, None)
    if begun is None:
        return load_audio(path)
    try:
        return begun.result()
    except (DataError, OSError):
        # Said by the unit that needs the file, in the file's present state.
        return load_audio(path)
