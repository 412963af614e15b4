"""Text and JSON about recipes and plug-ins, for ``dancedata list``.

Recipes are read and not made, so that neither pydantic nor the dataset's files are loaded.
"""

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from dancedata.core.registry import REGISTRIES
from dancedata.core.resources import resource, resources
from dancedata.exports.base.job import EXPORTS
from dancedata.recipes.yaml import read_yaml


def catalogue() -> dict[str, Any]:
    """Return all recipes and plug-ins, each with one line of description and its keys."""
    files = {name.removesuffix(".yaml"): resource("pipelines", name) for name in resources("pipelines")}
    entries: dict[str, Any] = {
        "recipes": {name: {"about": read_yaml(file).get("description", "")} for name, file in files.items()}
    }
    for kind, registry in {**REGISTRIES, "exports": EXPORTS}.items():
        entries[kind] = {name: _plugin_json(registry.get(name)) for name in registry.names()}
    return entries


def _plugin_json(cls: type[Any]) -> dict[str, Any]:
    summary = (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")
    keys = {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}
    if getattr(cls, "default_contacts", None) is not None:
        keys["contacts"] = cls.default_contacts
    return {"about": summary, "keys": keys}


def describe_catalogue(found: Mapping[str, Any]) -> str:
    """Return the output of `list`."""
    lines = []
    for kind, entries in found.items():
        lines.append(f"{kind}:")
        for name, entry in entries.items():
            lines.append(f"  {name}: {entry['about']}")
            if entry.get("keys"):
                lines.append(f"    keys: {', '.join(f'{k}={v!r}' for k, v in entry['keys'].items())}")
    return "\n".join(lines)
