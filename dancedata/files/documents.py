"""The parameters of plug-ins as JSON, and hashes of files that they name: for recipes, keys and dataset.json."""

import dataclasses
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef
from dancedata.core.plugin_files import FILE_KEY, plugin_file
from dancedata.files.regular_file import sha256_file


def document_of(plugin: Any, *, loading: bool = False) -> dict[str, Any]:
    """Return a plug-in's parameters as JSON, defaults included, but fields with the metadata ``{"path": True}``.

    With `loading`, a dataset's fields marked ``{"scan": True}`` are left out: they say which clips there are, not
    what `load` makes of one. A local plug-in has the hash of its file.
    """
    skipped = ("path", "scan") if loading else ("path",)
    fields = [f for f in dataclasses.fields(plugin) if not any(f.metadata.get(mark) for mark in skipped)]
    document = {f.name: _anything().dump_python(getattr(plugin, f.name), mode="json") for f in fields}
    file = plugin_file(type(plugin))
    return document if file is None else document | {FILE_KEY: file.sha256}


def clip_identity(ref: ClipRef) -> list[Any]:
    """Return all of a clip that `load` reads, except its file."""
    return [ref.id, ref.declared, str(ref.source_start), str(ref.source_end), ref.revision]


def content_hashes(plugin: Any, hash_file: Callable[[Path], str] = sha256_file) -> dict[str, str]:
    """Return hashes of the files that parameters with the metadata ``{"content": True}`` name, by `hash_file`."""
    hashes: dict[str, str] = {}
    for f in dataclasses.fields(plugin):
        path = getattr(plugin, f.name)
        if f.metadata.get("content") and path is not None:
            root = Path(path).expanduser()
            files = sorted(p for p in root.rglob("*") if p.is_file()) if root.is_dir() else [root]
            for file in files:
                if file.exists():
                    named = file.relative_to(root if root.is_dir() else root.parent).as_posix()
                    hashes[f"{f.name}/{named}"] = hash_file(file)
    return hashes


@lru_cache(maxsize=1)
def _anything() -> Any:
    # Imported here: worker processes make no keys, and need no pydantic.
    from pydantic import TypeAdapter

    return TypeAdapter(Any)
