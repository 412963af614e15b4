"""The instructions that results are computed with: the same on every x86-64 processor with AVX2.

BLAS and numpy choose among kernels by the processor, and kernels round differently: MFCC by up to 4e-4. What is in a
dataset, and in a cache that machines share, is computed with those of one level, x86-64-v3 (AVX2 and FMA).

The choice is made when the libraries are loaded, from the environment. The command line makes it for itself, and
workers are started with it; where a process has loaded the libraries before, as a notebook has, a worker computes
what has to be exact. What may not start one, such as a worker of a DataLoader, computes as it does; so do machines
without the choice (no AVX2, another architecture, BLAS or system): their keys have a description, so that results are
never mixed.
"""

import multiprocessing
import os
import platform
import re
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from dancedata.core.packages import package_version
from dancedata.core.system import SYSTEM, processor, processor_flags, started_with

T = TypeVar("T")

#: The instructions that results are computed with wherever possible, as named in keys and dataset.json.
REFERENCE = "x86-64-v3"
#: Flags of /proc/cpuinfo that make up the level; numpy's names of what is beyond it.
_FLAGS = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
_BEYOND = re.compile("AVX512|X86_V4")
#: Variable that chooses, among other things, between versions of the C library's functions.
_TUNABLES, _TUNES_CODE = "GLIBC_TUNABLES", "glibc.cpu."
#: Whether `adopt` has changed this process.
_is_adopted = False


@lru_cache(maxsize=1)
def has_reference() -> bool:
    """Return whether this machine computes as others of its kind do: Linux, and a processor of the level."""
    return SYSTEM == "linux" and platform.machine() == "x86_64" and processor_flags() >= _FLAGS


def variables() -> dict[str, str]:
    """Return the environment variables of processes that compute so; empty ones undo what a user has chosen."""
    # Nor must a module of the working folder stand in for one that computes, as where Python is started with -m.
    others = {"PYTHONSAFEPATH": "1"}
    if not has_reference():
        return others
    is_renamed = tuple(map(int, package_version("numpy").split(".")[:2])) >= (2, 4)  # its groups of features are
    tunables = os.environ.get(_TUNABLES, "").split(":")
    return others | {
        "OPENBLAS_CORETYPE": "Haswell",
        # KiB, Haswell's. OpenBLAS 0.3.34, in numpy 2.5, gives these kernels the blocks of Zen 4 where it finds 1 MiB:
        # they are larger than the kernels' memory on the stack, and products of 350 terms crash (its issue 6026).
        "OPENBLAS_L2_SIZE": "256",
        "OPENBLAS_BLOCK_FACTOR": "",
        "NPY_ENABLE_CPU_FEATURES": "X86_V3" if is_renamed else "SSSE3 SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2",
        "NPY_DISABLE_CPU_FEATURES": "",
        _TUNABLES: ":".join(tunable for tunable in tunables if not tunable.startswith(_TUNES_CODE)),
    }


def adopt() -> None:
    """Make this process and its children use the reference instructions, unless numpy is loaded already."""
    global _is_adopted
    if "numpy" not in sys.modules:
        os.environ.update(variables())
        _is_adopted = True


def _is_chosen() -> bool:
    """Return whether this process's libraries were loaded with `variables`; the C library is when it starts."""
    started = set(started_with())
    is_so = _is_adopted or started >= {f"{n}={value}" for n, value in variables().items() if n != _TUNABLES}
    return is_so and not any(line.startswith(_TUNABLES) and _TUNES_CODE in line for line in started)


def here() -> str:
    """Return the instructions that this process computes with: `REFERENCE`, or a description."""
    # Modules load libraries: these are looked up again after imports.
    return _description(len(sys.modules))


@lru_cache(maxsize=1)
def _description(n_modules: int) -> str:
    from numpy.lib.introspect import opt_func_info

    pools = _blas_pools()
    blas = sorted({f"{p['internal_api']} {p.get('architecture', p.get('version'))}" for p in pools})
    # The features that numpy's functions were compiled for, such as "X86_V3".
    code = sorted({each["current"].split("(")[0] for codes in opt_func_info().values() for each in codes.values()})
    if has_reference() and _is_chosen() and blas == ["openblas Haswell"] and not _BEYOND.search(str(code)):
        return REFERENCE
    names = ("OPENBLAS_CORE", "OPENBLAS_L2", "OPENBLAS_BLOCK", "NPY_", "MKL_CBWR", "MKL_ENABLE", "BLIS_ARCH")
    lines = sorted(line for line in started_with() if not line.endswith("="))
    chosen = [line for line in lines if line.startswith(names) or (_TUNABLES in line and _TUNES_CODE in line)]
    return ", ".join([platform.machine(), *blas, "numpy " + " ".join(code), processor(), SYSTEM, *chosen])


def _blas_pools() -> list[dict[str, Any]]:
    import numpy as np  # noqa: F401  (loads one)
    from threadpoolctl import threadpool_info

    return [pool for pool in threadpool_info() if pool["user_api"] == "blas"]


def expected() -> str:
    """Return the instructions that this process's exact results are computed with, here or by a worker."""
    current = here()
    # A daemonic process, such as a worker of a DataLoader or of Dask, may not start others.
    if current == REFERENCE or not has_reference() or _is_chosen() or multiprocessing.current_process().daemon:
        return current
    # OpenBLAS as wheels have it has kernels for many processors; of another BLAS a worker tells.
    return REFERENCE if any(pool.get("prefix") == "libscipy_openblas" for pool in _blas_pools()) else _of_workers()


def start_trackers() -> None:
    """Start the processes that remove the semaphores of killed processes, loky's and multiprocessing's, in silence.

    Started with the workers, they would unblock SIGINT for them. A process that an interrupt ends within a clean-up
    may have removed a semaphore without telling them: they would then print warnings behind its last line.
    """
    from joblib.externals.loky.backend import resource_tracker as of_loky

    options = sys.warnoptions
    sys.warnoptions = [*options, "ignore:resource_tracker:UserWarning"]  # handed on to the processes
    try:
        resource_tracker.ensure_running()
        of_loky.ensure_running()
    finally:
        sys.warnoptions = options


@lru_cache(maxsize=1)
def _of_workers() -> str:
    from joblib.externals.loky import ProcessPoolExecutor

    start_trackers()
    with ProcessPoolExecutor(1, env=variables()) as pool:
        found: str = pool.submit(here).result()
    return found


def on_one_thread(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)``, computed on one thread."""
    with one_thread():
        return function(*args)


def one_thread() -> AbstractContextManager[Any]:
    """Run BLAS and OpenMP on one thread within the context, so that the last digits do not depend on their number."""
    # Modules load libraries: these are looked up again after imports, which takes a millisecond.
    limits: AbstractContextManager[Any] = _thread_pools(len(sys.modules)).limit(limits=1)
    return limits


@lru_cache(maxsize=1)
def _thread_pools(n_modules: int) -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
