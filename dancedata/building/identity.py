"""What `load` of a reader makes a motion of, beside its file."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef
from dancedata.files.regular_file import sha256_file


def clip_identity(ref: ClipRef) -> list[Any]:
    """Return all of a clip that `load` reads, except its file."""
    return [ref.id, ref.declared, str(ref.source_start), str(ref.source_end), ref.revision]


def content_hashes(plugin: Any, hash_file: Callable[[Path], str] = sha256_file) -> dict[str, str]:
    """Return the hashes of the files that a plug-in's parameters name, such as a body model.

    These are the fields with the metadata ``{"content": True}``; of a folder all files. `hash_file` returns the
    SHA-256 of a file, such as `Cache.file_sha256`.
    """
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
