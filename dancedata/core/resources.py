"""Recipes and manifests that are part of the package."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean

_PACKAGE = Path(__file__).resolve().parent.parent


def resources(kind: str) -> tuple[str, ...]:
    """Return the names of all files of a kind ("pipelines" or "manifests"), sorted."""
    return tuple(sorted(p.name for p in _folder(kind).iterdir() if p.suffix == ".yaml"))


def resource(kind: str, name: str) -> Path:
    """Return the path of a file of the package; UsageError for an unknown name, with the closest one."""
    path = _folder(kind) / name
    if name not in resources(kind):
        raise UsageError(f"no {name!r} among the {kind}", fix=did_you_mean(name, resources(kind)))
    return path


@cache
def manifest(name: str) -> Mapping[str, Any]:
    """Return the published facts about a dataset, ``manifests/<name>.yaml``, which is read once."""
    import yaml

    content: Mapping[str, Any] = yaml.safe_load(resource("manifests", f"{name}.yaml").read_text(encoding="utf-8"))
    return content


def _folder(kind: str) -> Path:
    # In a wheel these folders are inside the package, in a checkout next to it.
    for folder in (_PACKAGE / "_resources" / kind, _PACKAGE.parent / kind):
        if folder.is_dir():
            return folder
    raise UsageError(
        f"this installation has no {kind}", where=_PACKAGE, fix="install dancedata again: its data files are missing"
    )
