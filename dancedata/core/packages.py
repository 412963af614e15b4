"""Versions of installed distributions; optional packages: which extra brings them, and how to install them.

dancedata itself may be on no index, so commands name the packages of an extra, from the installed metadata.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

from dancedata.core.errors import UsageError

if TYPE_CHECKING:
    from packaging.requirements import Requirement

#: Modules of each extra that are imported.
MODULES = {
    "torch": ("torch",),
    "jukebox": ("torch", "accelerate", "requests"),
    "hf": ("torch", "transformers", "accelerate", "safetensors", "huggingface_hub"),
    "beats": ("torch", "safetensors"),
    "dask": ("dask", "distributed"),
    "ray": ("ray",),
    "smpl": ("smplx", "torch"),
    "report": ("matplotlib",),
    "pandas": ("pandas",),
    "parquet": ("pyarrow",),
    "lightning": ("lightning", "torch"),
    "video": ("imageio_ffmpeg", "matplotlib"),
    "remote": ("huggingface_hub", "obstore"),
}


class MissingPackageError(UsageError, ImportError):
    """An optional package is not installed."""


@lru_cache
def package_version(name: str) -> str:
    """Return the version of an installed distribution; ModuleNotFoundError if it is not installed."""
    # Imported here, with a mail parser: help and worker processes need no version.
    import importlib.metadata

    return importlib.metadata.version(name)


def requirements() -> tuple[str, ...]:
    """Return the installed distribution's requirements, as in its metadata; empty if not installed as one."""
    import importlib.metadata

    try:
        return tuple(importlib.metadata.requires("dancedata") or ())
    except importlib.metadata.PackageNotFoundError:
        return ()


def needed_by(extra: str, required: Sequence[str]) -> list[Requirement]:
    """Return the additional requirements of an extra; for extra "" those of dancedata itself."""
    from packaging.requirements import Requirement

    parsed = [Requirement(text) for text in required]
    always = [r for r in parsed if r.marker is None or r.marker.evaluate({"extra": ""})]
    others = [r for r in parsed if r not in always and r.name != "dancedata"]
    return [r for r in others if r.marker is not None and r.marker.evaluate({"extra": extra})] if extra else always


def install(extra: str, required: Sequence[str] | None = None) -> str:
    """Return the command that installs the packages of an extra; `required` as `requirements` returns them."""
    needed = needed_by(extra, requirements() if required is None else required)
    for requirement in needed:
        requirement.marker = None
    names = " ".join(f'"{requirement}"' for requirement in needed)
    return f"pip install {names}" if names else f'pip install ".[{extra}]" in a checkout of dancedata'


def require(extra: str, modules: Sequence[str] = (), *, what: str = "", instead: str = "") -> None:
    """Raise MissingPackageError unless packages of an extra, or its `modules`, are installed for `what`."""
    missing = [name for name in modules or MODULES[extra] if not _is_installed(name)]
    if missing:
        are = "is" if len(missing) == 1 else "are"
        problem = f"{what or 'this'} needs {' and '.join(missing)}, which {are} not installed"
        raise MissingPackageError(problem, fix=f"{install(extra)}{instead and '. ' + instead}")


def load(module: str, extra: str, what: str = "") -> ModuleType:
    """Import a module of an extra; MissingPackageError where it is not installed."""
    require(extra, [module.partition(".")[0]], what=what)
    return import_module(module)


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # if something else takes its place
        return False
