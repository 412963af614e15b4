"""Registries of plug-ins: one file, one plug-in, found by itself."""

from __future__ import annotations

import dataclasses
import importlib
import os
import pkgutil
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, Generic, TypeVar

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.plugin_files import is_local, note_registered, unknown_plugin, without_file_key
from dancedata.core.plugins import (
    AudioFeature,
    Augmentation,
    ContactRule,
    Dataset,
    KeyMotionFinder,
    Metric,
    Plugin,
    Representation,
    WindowFilter,
)

P = TypeVar("P", bound=Plugin)
C = TypeVar("C", bound=type[Plugin])

#: Held while plug-ins are loaded. One lock for all kinds: no two threads wait for each other.
_loading = threading.RLock()
# A process that is forked during that time would wait for a thread that it does not have.
os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_loading.release)


class Registry(Generic[P]):
    """Plug-in classes of one kind by name.

    Plug-ins are the modules of `package` (those whose names do not begin with "_"), and the entry points of
    the group of the same name, for plug-ins in other distributions. Each registers a frozen dataclass, whose
    fields are the keys a recipe may set.

    Modules are imported when they are needed: to find one plug-in, that of its name, with "p" for "+" (aistpp has
    "aist++") and "_" for "-", is imported before the others; for the names of all, every module is.

    Parameters
    ----------
    kind
        What the plug-ins are, for messages: "dataset".
    package
        Where they live: "dancedata.datasets".
    base
        The class that all of them are derived from.
    """

    def __init__(self, kind: str, package: str, base: type[P]) -> None:
        self.kind = kind
        self.package = package
        self.base = base
        self._classes: dict[str, type[P]] = {}
        self._begun: set[str] = set()
        self._done: set[str] = set()

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that registers a class under `name`, which becomes its attribute `name`.

        Raises
        ------
        UsageError
            When it is applied to a class that is not derived from `base` or lacks a member, or if another class has
            the name.
        """

        def decorate(cls: C) -> C:
            checked = self._checked(name, cls)
            old = self._classes.get(name, cls)
            same = (old.__module__, old.__qualname__) == (cls.__module__, cls.__qualname__)
            if not same and not (is_local(old) and is_local(cls) and old.__module__ != cls.__module__):
                raise UsageError(
                    f"two plug-ins are registered as the {self.kind} {name!r}",
                    found=f"{old.__module__}.{old.__qualname__} and {cls.__module__}.{cls.__qualname__}",
                )
            cls.name = name
            self._classes[name] = checked
            note_registered(cls, self.kind, name, lambda: decorate(cls))
            return cls

        return decorate

    def _checked(self, name: str, cls: type[Plugin]) -> type[P]:
        where = f"{self.kind} {name!r}, {cls.__module__}.{cls.__qualname__}"
        base = f"{self.base.__module__}.{self.base.__qualname__}"
        if not issubclass(cls, self.base):
            raise UsageError(f"a plug-in of this kind is derived from {self.base.__name__}", where=where,
                             found=", ".join(b.__qualname__ for b in cls.__bases__),
                             fix=f"derive the class from {base}")  # fmt: skip
        missing = sorted(m for m in getattr(cls, "__abstractmethods__", ()))
        missing += [] if hasattr(cls, "version") else ["version"]
        if missing:
            raise UsageError(
                f"the plug-in lacks {', '.join(missing)}", where=where, fix=f"see the documentation of {base}"
            )
        return cls

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        self._load()
        return tuple(sorted(self._classes))

    def __contains__(self, name: object) -> bool:
        return self._find(name) is not None

    def get(self, name: str, also: Iterable[str] = (), parameters: object = None) -> type[P]:
        """Return a plug-in class; UsageError with the closest known name, or of `also`, see `did_you_mean`.

        `parameters`, those of a stored recipe, tell whether it was a local plug-in.
        """
        cls = self._find(name)
        if cls is None:
            raise unknown_plugin(self.kind, name, parameters, self.names(), also)
        return cls

    def split(self, name: str) -> tuple[str, str | None]:
        """Split PLUGIN.NAME at the longest registered name; the second is None without a name after it."""
        parts = name.split(".")
        for n in range(len(parts) - 1, 0, -1):
            plugin = ".".join(parts[:n])
            if name not in self and plugin in self:
                return plugin, ".".join(parts[n:])
        return name, None

    def make(self, name: str, parameters: Mapping[str, Any]) -> P:
        """Make a plug-in without the packages that recipes are checked with.

        Raises
        ------
        UsageError
            For an unknown name or parameter, and as the plug-in itself.
        """
        cls: type[Any] = self.get(name, parameters=parameters)
        parameters = without_file_key(cls, dict(parameters), f"{self.kind} {name}")
        keys = [field.name for field in dataclasses.fields(cls)]
        unknown = sorted(set(map(str, parameters)) - set(keys))
        if unknown:
            raise UsageError(
                f"the {self.kind} {name} has no parameter {unknown[0]!r}", fix=did_you_mean(unknown[0], keys)
            )
        # Lists, as JSON and YAML have them, are tuples in plug-ins.
        plugin: P = cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in parameters.items()})
        return plugin

    def _find(self, name: object) -> type[P] | None:
        if not isinstance(name, str):
            return None
        # Those of other distributions first, so that a name that is taken twice is an error in every case.
        self._once("installed", self._import_installed)
        module = name.replace("+", "p").replace("-", "_")
        if module.isidentifier() and not module.startswith("_"):
            self._once(f"module {module}", lambda: self._import_own(module))
        if name not in self._classes:
            self._load()
        return self._classes.get(name)

    def _load(self) -> None:
        self._once("package", self._import_package)
        self._once("installed", self._import_installed)

    def _once(self, step: str, run: Callable[[], None]) -> None:
        if step in self._done:
            return
        with _loading:
            # By another thread, or further up: a plug-in's module may request another plug-in.
            if step in self._begun:
                return
            self._begun.add(step)
            try:
                run()
            except BaseException:
                self._begun.remove(step)  # the next caller gets the error too, not a part of the plug-ins
                raise
            self._done.add(step)

    def _import_own(self, module: str) -> None:
        """Import the module of this name, if the package has one."""
        if find_spec(f"{self.package}.{module}") is not None:
            importlib.import_module(f"{self.package}.{module}")

    def _import_package(self) -> None:
        package = importlib.import_module(self.package)
        for module in pkgutil.iter_modules(package.__path__):
            if not module.name.startswith("_"):
                importlib.import_module(f"{self.package}.{module.name}")

    def _import_installed(self) -> None:
        for entry in _installed().select(group=self.package):
            try:
                entry.load()
            except UsageError:
                raise
            except Exception as error:
                of = f" of {entry.dist.name}" if entry.dist else ""
                raise UsageError(f"the {self.kind} {entry.name!r}{of} cannot be loaded",
                                 found=f"{type(error).__name__}: {error}",
                                 fix="repair or uninstall that distribution") from error  # fmt: skip


@lru_cache(maxsize=1)
def _installed() -> Any:
    # Imported here: worker processes look up no plug-in by name.
    from importlib.metadata import entry_points

    # Of all groups at once: each question reads the metadata of all installed packages.
    return entry_points()


DATASETS = Registry("dataset", "dancedata.datasets", Dataset)
REPRESENTATIONS = Registry("representation", "dancedata.representations", Representation)
CONTACTS = Registry("contact rule", "dancedata.contacts", ContactRule)
FEATURES = Registry("audio feature", "dancedata.audio", AudioFeature)
KEYMOTIONS = Registry("key motion", "dancedata.keymotion", KeyMotionFinder)
AUGMENTATIONS = Registry("augmentation", "dancedata.augment", Augmentation)
FILTERS = Registry("window filter", "dancedata.filters", WindowFilter)
METRICS = Registry("metric", "dancedata.metrics", Metric)


def beat_rows_late(field: str) -> int:
    """Return `AudioFeature.beat_rows_late` of a field, "librosa35" or "librosa35.60"; 0 without its plug-in."""
    plugin = field.split(".")[0]
    return FEATURES.get(plugin).beat_rows_late if plugin in FEATURES else 0


#: All of them, by their names in `dancedata list`; that of exports is next to their base class.
REGISTRIES: dict[str, Registry[Any]] = {
    "datasets": DATASETS,
    "representations": REPRESENTATIONS,
    "contacts": CONTACTS,
    "audio features": FEATURES,
    "key motions": KEYMOTIONS,
    "augmentations": AUGMENTATIONS,
    "window filters": FILTERS,
    "metrics": METRICS,
}
