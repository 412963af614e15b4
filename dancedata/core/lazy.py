"""Names of a package that are loaded when they are first used, so that importing the package stays light."""

import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str], *, modules: Collection[str] = (), extra: str = "", instead: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__`` (PEP 562).

    No name may be that of a submodule: importing the submodule would put it in the name's place.

    Parameters
    ----------
    package
        Its ``__name__``.
    homes
        Name -> module that has it, or "module:name" if its name differs.
    modules
        Names of subpackages and modules.
    extra, instead
        The extra of dancedata that the names need, and what to use without it; for MissingPackageError.
    """

    def get(name: str) -> Any:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            message = f"module {package!r} has no attribute {name!r}; it has {', '.join([*homes, *modules])}"
            raise AttributeError(message, name=name, obj=sys.modules[package])
        module, _, attribute = homes[name].partition(":")
        try:
            return getattr(import_module(module), attribute or name)
        except ModuleNotFoundError:
            if extra:
                from dancedata.core.packages import require

                require(extra, what=f"{package}.{name}", instead=instead)
            raise

    def names() -> list[str]:
        loaded = vars(sys.modules[package])
        return sorted(loaded.get("__all__", {*loaded, *homes, *modules}))

    return get, names
