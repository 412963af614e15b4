"""Names of a package that are loaded when they are first used, so that importing the package stays light."""

import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str], *, modules: Collection[str] = (), extra: str = "", instead: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's ``__getattr__`` and ``__dir__`` (PEP 562); no name may be that of a submodule.

    `homes`: Names by their module below dancedata, "open=open_store" for one that has another name there.
    `extra`, `instead`: The extra that the names need, and what to use without it; for MissingPackageError.
    """
    places = {}
    for module, named in homes.items():
        for name, _, attribute in (each.partition("=") for each in named.split()):
            places[name] = f"dancedata.{module}", attribute or name

    def get(name: str) -> Any:
        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in places:
            message = f"module {package!r} has no attribute {name!r}; it has {', '.join([*places, *modules])}"
            raise AttributeError(message, name=name, obj=sys.modules[package])
        module, attribute = places[name]
        try:
            return getattr(import_module(module), attribute)
        except ModuleNotFoundError:
            if extra:
                from dancedata.core.packages import require

                require(extra, what=f"{package}.{name}", instead=instead)
            raise

    def names() -> list[str]:
        loaded = vars(sys.modules[package])
        return sorted(loaded.get("__all__", {*loaded, *places, *modules}))

    return get, names
