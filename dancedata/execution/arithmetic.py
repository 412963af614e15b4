"""The instructions that results are computed with: the same on every x86-64 processor with AVX2, and on every ARM64.

BLAS and numpy choose among kernels by the processor, and kernels round differently: with AVX-512, MFCC differ by up
to 4e-4. A dataset, and a cache that machines share, must not depend on that. So everything in them is computed with
one choice, that of the level x86-64-v3 (AVX2 and FMA: Intel from 2013, AMD from 2017): OpenBLAS's kernels for
Haswell, and numpy's code for X86_V3. On ARM64 the level is armv8-a, which all of them have: OpenBLAS's kernels for
it, and numpy's code without extensions. The two levels round differently, and their results have different keys.

The choice is made when the libraries are loaded, from the environment. The command line makes it for itself and for
the workers that it starts (`adopt`). In a notebook or a training job the libraries may have been loaded before;
computations that have to be exact run in a second process there (`dancedata.execution.reference_process`).

Where this choice does not exist (no AVX2, another architecture or BLAS, another system than Linux), results depend on
the machine, and their keys contain a description of it, so that they are never mixed. docs/decisions.md
have the measurements.
"""

import os
import platform
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any, TypeVar

from dancedata.core.packages import version
from dancedata.core.system import SYSTEM, processor, processor_flags, started_with

T = TypeVar("T")

_IS_ARM = platform.machine() == "aarch64"
#: The instructions that results are computed with wherever possible, as named in keys and dataset.json.
REFERENCE = "armv8-a" if _IS_ARM else "x86-64-v3"
#: OpenBLAS's kernels for them.
_KERNELS = "ARMV8" if _IS_ARM else "Haswell"
#: Flags of /proc/cpuinfo that make up the level x86-64-v3.
_FLAGS = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
#: Variables by which users choose kernels or block sizes: they must not shape results.
_FOREIGN = (
    "OPENBLAS_CORETYPE",
    "OPENBLAS_BLOCK_FACTOR",
    "OPENBLAS_L2_SIZE",
    "NPY_ENABLE_CPU_FEATURES",
    "NPY_DISABLE_CPU_FEATURES",
    "MKL_CBWR",
    "MKL_ENABLE_INSTRUCTIONS",
    "BLIS_ARCH_TYPE",
)
#: The release 0.3.N of OpenBLAS since which kernels for Haswell may get the blocks of another processor: 31 has not.
_CHOOSES_BLOCKS = 32
#: Variable that chooses, among other things, between versions of the C library's functions.
_TUNABLES, _TUNES_CODE = "GLIBC_TUNABLES", "glibc.cpu."
#: Names in numpy's features of what is beyond the levels.
_BEYOND = ("AVX512", "X86_V4", "ASIMDHP", "ASIMDDP", "ASIMDFHM", "SVE")
# numpy 2.4 renamed its groups of features.
_NUMPY_FEATURES = {(2, 4): "X86_V3", (0, 0): "SSSE3 SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2"}


#: Whether `adopt` has changed this process.
_is_adopted = False


def environment() -> dict[str, str]:
    """Return this process's environment, changed so that a child uses the reference instructions."""
    changed = {**os.environ, **_changes()}
    return {name: value for name, value in changed.items() if value is not None}


def adopt() -> None:
    """Make this process and its children use the reference instructions, unless numpy is loaded already."""
    global _is_adopted
    if "numpy" not in sys.modules:
        _set(_changes())
        _is_adopted = True


@contextmanager
def adopted_by_children() -> Iterator[None]:
    """Start processes within the context in the environment of `environment`."""
    before = {name: os.environ.get(name) for name in _changes()}
    _set(_changes())
    try:
        yield
    finally:
        _set(before)


def _changes() -> dict[str, str | None]:
    """Return the variables to set; None: to be removed."""
    changes: dict[str, str | None] = dict.fromkeys(_FOREIGN)
    # Nor must a module of the working folder stand in for one that computes, as where Python is started with -m.
    changes["PYTHONSAFEPATH"] = "1"
    tunables = os.environ.get(_TUNABLES, "").split(":")
    changes[_TUNABLES] = ":".join(tunable for tunable in tunables if not tunable.startswith(_TUNES_CODE)) or None
    if has_reference():
        changes |= {"OPENBLAS_CORETYPE": _KERNELS, **_block_sizes(), **_numpy_choice()}
    return changes


def _block_sizes() -> dict[str, str]:
    # OpenBLAS 0.3.34, in numpy 2.5, gives its kernels for Haswell the blocks of Zen 4 where it finds an L2 cache of 1
    # MiB. These are larger than the kernels' memory on the stack: products of 350 terms crash (OpenBLAS issue 6026).
    return {} if _IS_ARM else {"OPENBLAS_L2_SIZE": "256"}  # KiB: Haswell's


def _has_other_blocks() -> bool:
    """Return whether OpenBLAS may have chosen its block sizes by this processor, see `_block_sizes`."""
    if _is_adopted or {f"{name}={size}" for name, size in _block_sizes().items()} <= set(started_with()):
        return False
    versions = (re.match(r"0\.3\.(\d+)", str(pool.get("version"))) for pool in _blas_pools())
    return any(known is None or int(known[1]) >= _CHOOSES_BLOCKS for known in versions)


def _numpy_choice() -> dict[str, str]:
    if _IS_ARM:
        return {"NPY_DISABLE_CPU_FEATURES": "ASIMDHP ASIMDDP ASIMDFHM SVE"}  # what it was compiled for stays
    return {"NPY_ENABLE_CPU_FEATURES": _numpy_features()}


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@lru_cache(maxsize=1)
def has_reference() -> bool:
    """Return whether this machine computes as others of its kind do: Linux, and a processor of the level."""
    if SYSTEM != "linux":  # other C libraries
        return False
    return _IS_ARM or (platform.machine() == "x86_64" and processor_flags() >= _FLAGS)


def _numpy_features() -> str:
    try:
        major, minor = (int(part) for part in version("numpy").split(".")[:2])
    except (ModuleNotFoundError, ValueError):
        major, minor = max(_NUMPY_FEATURES)
    return next(features for since, features in _NUMPY_FEATURES.items() if (major, minor) >= since)


def here() -> str:
    """Return the instructions that this process computes with: `REFERENCE`, or a description."""
    # Modules load libraries: these are looked up again after imports.
    return _description(len(sys.modules))


@lru_cache(maxsize=1)
def _description(n_modules: int) -> str:
    blas, numpy_code = _blas(), _numpy_code()
    is_reference = (
        has_reference()
        and [name.lower() for name in blas] == [f"openblas {_KERNELS}".lower()]
        and not any(_is_beyond(used) for used, _ in numpy_code)
        and not any(_is_left_out(used, available) for used, available in numpy_code)
        and not _set_at_start()
        and not _has_other_blocks()
    )
    if is_reference:
        return REFERENCE
    used = sorted({used.split("(")[0] for used, _ in numpy_code})
    parts = [platform.machine(), *blas, "numpy " + " ".join(used), *_set_at_start()]
    if SYSTEM != "linux":
        parts.append(SYSTEM)  # another C library, whose functions round otherwise
    if not all(name.startswith("openblas ") for name in blas):
        # Which kernels these choose cannot be read.
        parts.append(processor())
    return ", ".join(parts)


def _blas() -> list[str]:
    """Return the loaded BLAS libraries, with the kernels that they chose."""
    pools = _blas_pools()
    return sorted({f"{pool['internal_api']} {pool.get('architecture', pool.get('version'))}" for pool in pools})


def _blas_pools() -> list[dict[str, Any]]:
    import numpy as np  # noqa: F401  (loads one)
    from threadpoolctl import threadpool_info

    return [pool for pool in threadpool_info() if pool["user_api"] == "blas"]


def _numpy_code() -> list[tuple[str, list[str]]]:
    """Return, for each of numpy's functions, the features its code was compiled for, and all that it could use."""
    from numpy.lib.introspect import opt_func_info

    # Such as "X86_V3" of "X86_V4 X86_V3 baseline(X86_V2)".
    functions: list[dict[str, str]] = [code for codes in opt_func_info().values() for code in codes.values()]
    return [(code["current"], code["available"].split()) for code in functions]


def is_chosen_by_user() -> bool:
    """Return whether a process started with `environment` may use instructions other than this one's."""
    return has_reference() or bool(_set_at_start()) or any(x.split("=")[0] in _FOREIGN for x in started_with())


def can_choose() -> bool:
    """Return whether numpy's BLAS is known to have kernels for many processors: OpenBLAS, as wheels have it."""
    return any(pool.get("prefix") == "libscipy_openblas" for pool in _blas_pools())


def _is_beyond(features: str) -> bool:
    return any(name in features for name in _BEYOND)


def _is_left_out(used: str, available: list[str]) -> bool:
    """Return whether code up to the level is available but code for less is used."""
    best = next((features for features in available if not _is_beyond(features)), used)
    return best.split("(")[0] != used.split("(")[0]


def _set_at_start() -> list[str]:
    """Return the variables at the start of this process that choose code in the C library."""
    return [line for line in started_with() if line.startswith(f"{_TUNABLES}=") and _TUNES_CODE in line]


def exactly(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)`` as a build computes it: on one thread, with the instructions of `expected`.

    Raises
    ------
    ReferenceProcessError
        As for `reference_process.compute`.
    """
    # Imported here: exports, which `list` loads, seldom call this function.
    from dancedata.execution.reference_process import compute

    result: T = compute(on_one_thread, function, *args)
    return result


def as_in_builds(exact: bool) -> Callable[..., Any]:
    """Return the wrapper in which builds run units: `exactly` or `on_one_thread`."""
    return exactly if exact else on_one_thread


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
