"""What holds for plug-ins of every kind."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from typing import Any

from dancedata.core.registry import REGISTRIES, Registry
from dancedata.exports.base.job import EXPORTS
from dancedata.testing.require import require


def check_plugin(cls: type[Any]) -> None:
    """Check what all plug-ins share: a frozen dataclass whose fields are documented keys of a recipe."""
    require(dataclasses.is_dataclass(cls), f"{cls.__name__} is a dataclass")
    require(bool(cls.__dataclass_params__.frozen), f"{cls.__name__} is frozen")
    require(type(cls.version) is int and cls.version > 0, "version is a whole number above 0")
    text = inspect.getdoc(cls) or ""
    require(bool(text) and not text.startswith(f"{cls.__name__}("), f"{cls.__name__} has a docstring")
    described = "\n".join(inspect.getdoc(base) or "" for base in cls.__mro__)  # a base may add fields of its own
    for field in dataclasses.fields(cls):
        require(re.search(rf"^{field.name}\b", described, re.M) is not None, f"the docstring describes {field.name}")
    from dancedata.recipes.documents import document_of
    from dancedata.recipes.plugins import make_plugin, one_of

    problems: list[str] = []
    registry = registry_of(cls)
    made = make_plugin(registry, "plugin", cls.name, {}, problems)
    require(not problems, f"the defaults are valid parameters: {problems}")
    document = document_of(made)
    again = one_of(registry, "plugin", json.loads(json.dumps({cls.name: document})), problems)
    require(not problems, f"what a dataset says of its recipe can be read again: {problems}")
    require(again == made and document_of(again) == document, "parameters survive the way through JSON")
    make_plugin(registry, "plugin", cls.name, {"no_such_key": 1}, problems)
    require(any("no_such_key" in p for p in problems), "a key that no field has is an error")


def registry_of(cls: type[Any]) -> Registry[Any]:
    """Return the registry that a plug-in is in; AssertionError if it is in none."""
    for registry in (*REGISTRIES.values(), EXPORTS):
        if cls in (registry.get(name) for name in registry.names()):
            return registry
    raise AssertionError(f"expected: {cls.__name__} is registered")
