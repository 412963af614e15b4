"""Plug-ins by name and parameters, without the packages that recipes are checked with."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.plugins import Plugin
from dancedata.core.registry import Registry

P = TypeVar("P", bound=Plugin)


def named_plugin(registry: Registry[P], name: str, parameters: Mapping[str, Any]) -> P:
    """Make a plug-in; UsageError for an unknown name or parameter."""
    cls: type[Any] = registry.get(name)
    known = [f.name for f in dataclasses.fields(cls)]
    unknown = sorted(set(map(str, parameters)) - set(known))
    if unknown:
        raise UsageError(
            f"the {registry.kind} {name} has no parameter {unknown[0]!r}", fix=did_you_mean(unknown[0], known)
        )
    # Lists, as JSON and YAML have them, are tuples in plug-ins.
    made: P = cls(**{key: tuple(value) if isinstance(value, list) else value for key, value in parameters.items()})
    return made
