"""Names of a package that are loaded when they are first used, so that importing the package stays light."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str], *, without_torch: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__`` (PEP 562).

    No name may be that of a submodule: importing the submodule would put it in the name's place.

    Parameters
    ----------
    package
        Its ``__name__``.
    homes
        Name -> module that has it, or "module:name" where it is called otherwise there.
    without_torch
        For names that need torch: what to use without it. Where torch is not installed, ``__getattr__`` raises
        ImportError with this text.
    """

    def get(name: str) -> Any:
        if name not in homes:
            message = f"module {package!r} has no attribute {name!r}; it has {', '.join(homes)}"
            raise AttributeError(message, name=name, obj=sys.modules[package])
        module, _, attribute = homes[name].partition(":")
        try:
            return getattr(import_module(module), attribute or name)
        except ModuleNotFoundError as error:
            if not without_torch or error.name is None or error.name.split(".")[0] != "torch":
                raise
            raise ImportError(
                f"{package}.{name} needs torch, which is not installed here: pip install 'dancedata[torch]'. "
                f"{without_torch}"
            ) from error

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return get, names
