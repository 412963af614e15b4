"""Names of a package that are loaded when they are first used, so that importing the package stays light."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__`` (PEP 562).

    No name may be that of a submodule: importing the submodule would put it in the name's place.

    Parameters
    ----------
    package
        Its ``__name__``.
    homes
        Name -> module that has it, or "module:name" where it is called otherwise there.
    """

    def get(name: str) -> Any:
        if name not in homes:
            message = f"module {package!r} has no attribute {name!r}; it has {', '.join(homes)}"
            raise AttributeError(message, name=name, obj=sys.modules[package])
        module, _, attribute = homes[name].partition(":")
        return getattr(import_module(module), attribute or name)

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return get, names
