"""Registries of plug-ins: one file, one plug-in, found by itself."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.plugin_files import note_registered, plugin_file, unknown_plugin, without_file_key
from dancedata.core.plugins import AudioFeature, ContactRule, Dataset, Plugin, Representation

if TYPE_CHECKING:
    from dancedata.core.plugins import Augmentation, KeyMotionFinder, Metric, PrimitiveFinder, WindowFilter

P = TypeVar("P", bound=Plugin)
C = TypeVar("C", bound=type[Plugin])


class Registry(Generic[P]):
    """Plug-in classes of one kind by name.

    Plug-ins are the modules of `package` (those whose names do not begin with "_"), and the entry points of the group
    of the same name, for plug-ins in other distributions. Where the package is a folder of a room, such as
    `dancedata.building.rules`, they are also the modules of its name in other rooms: `dancedata.curation.rules`. Each
    registers a frozen dataclass, whose fields are the keys a recipe may set.

    Modules are imported when they are needed: to find one plug-in, that of its name, with "p" for "+" (aistpp has
    "aist++") and "_" for "-", is imported before the others; for the names of all, every module is.

    Parameters
    ----------
    kind
        What the plug-ins are, for messages: "dataset".
    package
        Where they live: "dancedata.datasets".
    base
        The class that all of them are derived from; "ROOM.MODULE:NAME" for one that is loaded with the first of them.
    """

    def __init__(self, kind: str, package: str, base: type[P] | str) -> None:
        self.kind = kind
        self.package = package
        self._base = base
        self._classes: dict[str, type[P]] = {}
        self._loaded: Any = None

    @property
    def base(self) -> type[P]:
        """The class that all plug-ins are derived from."""
        if isinstance(self._base, str):
            module, _, name = self._base.partition(":")
            base: type[P] = getattr(importlib.import_module(f"{self.package.partition('.')[0]}.{module}"), name)
            self._base = base
        return self._base

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that registers a class under `name`, which becomes its attribute `name`.

        UsageError for a class that is not derived from `base` or lacks a member, and for a name that is taken.
        """

        def decorate(cls: C) -> C:
            checked = self._checked(name, cls)
            old = self._classes.get(name, cls)
            same = (old.__module__, old.__qualname__) == (cls.__module__, cls.__qualname__)
            if not same and not (plugin_file(old) and plugin_file(cls) and old.__module__ != cls.__module__):
                raise UsageError(
                    f"two plug-ins are registered as the {self.kind} {name!r}",
                    found=f"{old.__module__}.{old.__qualname__} and {cls.__module__}.{cls.__qualname__}",
                )
            note_registered(cls, self.kind, name)
            cls.name = name
            self._classes[name] = checked
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
        if missing:
            raise UsageError(
                f"the plug-in lacks {', '.join(missing)}", where=where, fix=f"see the documentation of {base}"
            )
        return cls

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        self._load_installed()
        for module in _modules(self.package):
            importlib.import_module(module)
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

    def only(self) -> P:
        """Return the plug-in of a kind of which one is enough; UsageError if none is installed."""
        for name in self.names():
            return self.make(name, {})
        raise UsageError(f"no {self.kind} is installed", fix="install the whole of dancedata, or a plug-in")

    def split(self, name: str) -> tuple[str, str | None]:
        """Split PLUGIN.NAME at the longest registered name; the second is None without a name after it."""
        parts = name.split(".")
        for n in range(len(parts) - 1, 0, -1):
            plugin = ".".join(parts[:n])
            if name not in self and plugin in self:
                return plugin, ".".join(parts[n:])
        return name, None

    def make(self, name: str, parameters: Mapping[str, Any]) -> P:
        """Make a plug-in; UsageError for an unknown name or parameter, and as the plug-in itself.

        pydantic, with which recipes are checked, is not imported.
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
        self._load_installed()
        own = f"{self.package}.{name.replace('+', 'p').replace('-', '_')}"
        if own in _modules(self.package):
            importlib.import_module(own)
        if name not in self._classes:
            self.names()
        return self._classes.get(name)

    def _load_installed(self) -> None:
        if self._loaded is (installed := _installed()):
            return
        for entry in installed.select(group=self.package):
            try:
                entry.load()
            except UsageError:
                raise
            except Exception as error:
                of = f" of {entry.dist.name}" if entry.dist else ""
                raise UsageError(f"the {self.kind} {entry.name!r}{of} cannot be loaded",
                                 found=f"{type(error).__name__}: {error}",
                                 fix="repair or uninstall that distribution") from error  # fmt: skip
        self._loaded = installed  # all of its entries


@lru_cache
def _modules(package: str) -> tuple[str, ...]:
    modules = [f"{package}.{m.name}" for m in _in(package) if not m.name.startswith("_")]
    root, _, folder = package.partition(".")
    folder = folder.partition(".")[2]
    for room in _in(root) if folder else ():  # which is not imported to look into it
        files = pkgutil.iter_modules(os.path.join(p, room.name) for p in importlib.import_module(root).__path__)
        modules += [f"{root}.{room.name}.{folder}" for m in files if m.name == folder and not m.ispkg]
    return tuple(modules)


def _in(package: str) -> Iterable[pkgutil.ModuleInfo]:
    if importlib.util.find_spec(package) is None:  # one that was taken out
        return ()
    return pkgutil.iter_modules(importlib.import_module(package).__path__)


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
KEYMOTIONS: Registry[KeyMotionFinder] = Registry("key motion", "dancedata.keymotion", "core.plugins:KeyMotionFinder")
PRIMITIVE_FINDERS: Registry[PrimitiveFinder] = Registry(
    "finder of primitives", "dancedata.keymotion", "core.plugins:PrimitiveFinder"
)
AUGMENTATIONS: Registry[Augmentation] = Registry("augmentation", "dancedata.augment", "core.plugins:Augmentation")
FILTERS: Registry[WindowFilter] = Registry("window filter", "dancedata.filters", "core.plugins:WindowFilter")
METRICS: Registry[Metric] = Registry("metric", "dancedata.metrics", "core.plugins:Metric")
#: A wall asks the protocol "dancedata" for `clip_scores`.
PROTOCOLS: Registry[Any] = Registry("protocol", "dancedata.evaluation.protocols", "evaluation.protocol:Protocol")
FIELDS: Registry[Any] = Registry("field", "dancedata.building.fields", "building.plugins:Field")
TRANSFORMS: Registry[Any] = Registry("transform", "dancedata.building.transforms", "building.take:Transform")
ANNOTATORS: Registry[Any] = Registry("annotator", "dancedata.building.annotators", "building.plugins:Annotator")
RULES: Registry[Any] = Registry("window rule", "dancedata.building.rules", "building.plugins:WindowRule")
STARTS: Registry[Any] = Registry("finder of offsets", "dancedata.alignment", "building.plugins:StartFinder")
ENGINES: Registry[Any] = Registry("engine of clusters", "dancedata.clusters", "execution.engines:Engine")


def beat_rows_late(field: str) -> int:
    """Return `AudioFeature.beat_rows_late` of a field, "librosa35" or "librosa35.60"; 0 without its plug-in."""
    plugin = field.split(".")[0]
    return FEATURES.get(plugin).beat_rows_late if plugin in FEATURES else 0


#: All of them, by their names in `dancedata info plugins`; that of exports is next to their base class.
REGISTRIES: dict[str, Registry[Any]] = {
    "datasets": DATASETS,
    "representations": REPRESENTATIONS,
    "contacts": CONTACTS,
    "audio features": FEATURES,
    "key motions": KEYMOTIONS,
    "augmentations": AUGMENTATIONS,
    "window filters": FILTERS,
    "metrics": METRICS,
    "fields": FIELDS,
    "transforms": TRANSFORMS,
    "annotators": ANNOTATORS,
    "window rules": RULES,
}
