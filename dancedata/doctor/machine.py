"""Checks of the machine: the cache folder, the processor, worker processes, decoders of music."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from dancedata.core.locks import lock_file, unlock
from dancedata.doctor.finding import Finding, failed, note, ok
from dancedata.execution import arithmetic
from dancedata.execution.cache import ENVIRONMENT, default_cache
from dancedata.execution.progress import Progress
from dancedata.execution.reference_process import expected
from dancedata.execution.units import run_units

#: Bytes: a window-scope dataset of AIST++ with librosa35 takes about this much of the cache.
_AMPLE, _LEAST = 10 * 10**9, 10**8
_CACHE_FIX = f"set {ENVIRONMENT} to a writable folder with free space"
_RATE = 22_050
#: Formats that songs have, by their extension; the encoding that is written of each.
_FORMATS = {"wav": "PCM_16", "flac": "PCM_16", "ogg": "VORBIS", "mp3": "MPEG_LAYER_III"}


def check_cache() -> Iterator[Finding]:
    """Write, lock and remove a file where the cache is, or would be made."""
    root = default_cache().absolute()
    there = next(folder for folder in (root, *root.parents) if os.path.lexists(folder))
    text = str(root) if there == root else f"{root}, which is made by the first build"
    try:
        _require_writable(there if there == root else None)
        with tempfile.TemporaryDirectory(prefix=".dancedata-doctor-", dir=there) as folder:
            has_locks = _locks_work(Path(folder) / "lock")
        free = shutil.disk_usage(there).free
    except OSError as error:
        yield failed("cache", f"{root} cannot be written: {error}", _CACHE_FIX)
        return
    text += f"; {free / 1e9:.1f} GB free"
    if free < _LEAST:
        yield failed("cache", text, _CACHE_FIX)
    elif not has_locks:
        fix = f"with several builds at once, set {ENVIRONMENT} to a file system with locks (docs/cluster.md)"
        yield note("cache", f"{text}; the file system has no locks: processes may compute the same twice", fix)
    elif free < _AMPLE:
        yield note("cache", f"{text}; locks work", "make space before a large build, or dancedata cache prune")
    else:
        yield ok("cache", f"{text}; locks work")


def _require_writable(cache: Path | None) -> None:
    """Raise OSError for a folder of the cache that entries cannot be put into, such as one of another user."""
    for folder, _, _ in os.walk(cache) if cache is not None else ():
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder)


def _locks_work(path: Path) -> bool:
    """Tell whether a lock on a file is seen by another descriptor of it, as by another process."""
    first = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
    second = os.open(path, os.O_RDWR)
    try:
        held = lock_file(first, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return held is True and lock_file(second, fcntl.LOCK_EX | fcntl.LOCK_NB) is False
    finally:
        unlock(second)
        unlock(first)


def check_processor() -> Iterator[Finding]:
    """Compare the instructions that results are computed with, with those of all machines."""
    chosen = expected()
    if chosen == arithmetic.REFERENCE:
        yield ok("processor", f"computes with {chosen}: the same bytes as on every processor with AVX2")
    else:
        why = "numpy's BLAS is not OpenBLAS" if arithmetic.has_reference() else "it is not an x86-64 with AVX2"
        fix = "results are kept apart from those of other machines in caches and datasets (docs/decisions/0023)"
        yield note("processor", f"computes with {chosen}, as {why}", fix)


def check_workers() -> Iterator[Finding]:
    """Start two worker processes, and ask them what they compute with."""
    here = os.getpid()
    found = run_units(_about_worker, [(0,), (1,)], jobs=2, label="workers", progress=Progress(quiet=True))
    others = sorted({used for _, used in found if used != expected()})
    if others:
        yield failed(
            "workers", f"they compute with {', '.join(others)}, not {expected()}", "report it: this is a bug"
        )
    elif here in {pid for pid, _ in found}:
        yield note("workers", "none may be started by this process, as it is a daemonic one itself")
    else:
        yield ok("workers", f"start and compute; {os.cpu_count()} cores")


def _about_worker(number: int) -> tuple[int, str]:
    """Return a worker's process id and instructions; units are numbered."""
    return os.getpid(), arithmetic.here()


def check_music() -> Iterator[Finding]:
    """Write a second of music in every format, and decode it as a build does."""
    import numpy as np
    import soundfile

    from dancedata.audio.signal import load_audio

    sine = 0.5 * np.sin(2 * np.pi * 440 * np.arange(_RATE) / _RATE)
    readable, problems = [], []
    with tempfile.TemporaryDirectory(prefix="dancedata-doctor-") as folder:
        for suffix, encoding in _FORMATS.items():
            path = Path(folder) / f"a.{suffix}"
            try:
                soundfile.write(path, sine, _RATE, format=suffix.upper(), subtype=encoding)
                peak = float(np.abs(load_audio(path).samples).max())
            except Exception as error:  # noqa: BLE001  (a decoder that is broken raises anything)
                problems.append(f"{suffix} ({error})")
                continue
            readable += [suffix] if 0.4 < peak < 0.6 else []
            problems += [] if 0.4 < peak < 0.6 else [f"{suffix} (decoded to other samples)"]
    version = f"libsndfile {soundfile.__libsndfile_version__}"
    if "wav" not in readable:
        yield failed(
            "music", f"{version} does not read {'; '.join(problems)}", "pip install --force-reinstall soundfile"
        )
    elif problems:
        fix = "pip install --upgrade soundfile, or convert such songs to wav or flac"
        yield note("music", f"{version} writes and reads {', '.join(readable)}, not {'; '.join(problems)}", fix)
    else:
        yield ok("music", f"{version} writes and reads {', '.join(readable)}")
    if shutil.which("ffmpeg") is None:
        fix = "it is not needed for wav, flac, ogg and mp3; it converts other files: ffmpeg -i song.m4a song.wav"
        yield note("ffmpeg", "not installed here", fix)
    else:
        yield ok("ffmpeg", "installed; it is not needed, and converts other files: ffmpeg -i song.m4a song.wav")
