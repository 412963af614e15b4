"""The parameters of plug-ins as JSON: for recipes, keys of the cache and dataset.json."""

import dataclasses
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

from dancedata.core.plugin_files import FILE_KEY, plugin_file


def document_of(plugin: Any, *, loading: bool = False) -> dict[str, Any]:
    """Return a plug-in's parameters as JSON, defaults included; fields marked as paths are left out.

    A field is a path if its metadata contain ``{"path": True}``: its content is hashed with the source, and
    its place shapes nothing. With `loading`, a dataset's fields marked ``{"scan": True}`` are left out
    as well: they decide which clips there are, not what `load` makes of one, so they are not part of its key. A local
    plug-in has the hash of its file, too.
    """
    skipped = ("path", "scan") if loading else ("path",)
    fields = [f for f in dataclasses.fields(plugin) if not any(f.metadata.get(mark) for mark in skipped)]
    document = {f.name: _anything().dump_python(getattr(plugin, f.name), mode="json") for f in fields}
    file = plugin_file(type(plugin))
    return document if file is None else document | {FILE_KEY: file.sha256}


def document_differences(old: Any, new: Any, at: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield (key, old value, new value) for every key in which two JSON documents differ."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted({*old, *new}):
            yield from document_differences(old.get(key), new.get(key), f"{at}.{key}" if at else str(key))
    elif old != new:
        yield at, old, new


def shaping(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a recipe that affect a dataset: all except its name and description."""
    return {key: value for key, value in recipe.items() if key not in ("name", "description")}


@lru_cache(maxsize=1)
def _anything() -> Any:
    # Imported here: worker processes make no keys, and need no pydantic.
    from pydantic import TypeAdapter

    return TypeAdapter(Any)
