"""Names of a package that are imported when they are first used, so that importing the package stays fast."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str], *, torch: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of a package (PEP 562).

    Parameters
    ----------
    package
        ``__name__`` of the package.
    homes
        Where each public name is: "module:attribute", or "module" where the attribute has the same name.
    torch
        Where the names need torch: what can be done without it, for the error that names the missing package.

    Raises
    ------
    AttributeError
        By `__getattr__`, for a name that is not in `homes`.
    ImportError
        By `__getattr__`, where torch is not installed and `torch` is given.
    """

    def load(name: str) -> Any:
        if name not in homes:
            message = f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(homes))}"
            raise AttributeError(message, name=name, obj=sys.modules[package])
        module, _, attribute = homes[name].partition(":")
        try:
            return getattr(import_module(module), attribute or name)
        except ModuleNotFoundError as error:
            if not torch or error.name is None or error.name.split(".")[0] != "torch":
                raise
            raise ImportError(
                f"{package}.{name} needs torch, which is not installed here: pip install 'dancedata[torch]'. {torch}"
            ) from error

    def names() -> list[str]:
        # As dir() without `__dir__`: what has been imported so far, and the lazy names.
        return sorted({*vars(import_module(package)), *homes})

    return load, names
