"""Plug-ins in single Python files that a recipe, an option or a call names: local plug-ins.

The hash of a file's bytes is part of the documents of its plug-ins (`dancedata.files.documents`), and with them of
cache keys and of a recipe's hash. Files are executed only where `load_plugins` names them; worker processes get the
classes with their code.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle

from dancedata.core.errors import DanceDataError, UsageError, did_you_mean

#: Key of the hash of a plug-in's file among its parameters, in the documents of recipes.
FILE_KEY = "plugin_sha256"
_LOAD = "load the file: --plugin FILE, or dancedata.load_plugins(FILE) in Python"


@dataclass(frozen=True)
class PluginFile:
    """A file with plug-ins: its absolute path, and the SHA-256 of its bytes."""

    path: Path
    sha256: str


#: Files by the names of their modules, and what the files of a call register.
_files: dict[str, PluginFile] = {}
_registered: dict[tuple[str, str], str] = {}


def load_plugins(*files: str | Path) -> tuple[PluginFile, ...]:
    """Load local plug-ins: Python files that register some, as ``plugins:`` of a recipe and ``--plugin`` do.

    The files are executed. Plug-ins replace those of the same kind and name of files that were loaded before, not
    those of dancedata and of other distributions. A file cannot import others next to it: make a package of several.

    Parameters
    ----------
    files
        Paths of .py files.

    Returns
    -------
    tuple of PluginFile
        The files with the SHA-256 of their bytes.

    Raises
    ------
    UsageError
        For a file that does not exist, raises an error or registers nothing, and for two that register one name.

    Examples
    --------
    >>> import dancedata
    >>> dancedata.load_plugins("loudness.py")[0].sha256  # doctest: +SKIP
    'f2ca1bb6c7e907d06dafe4687e579fce76b37e4e93b7605022da52e6ccc26fd2'
    """
    _registered.clear()
    return tuple(_load(path) for path in dict.fromkeys(Path(file).expanduser().absolute() for file in files))


def _load(path: Path) -> PluginFile:
    n_before = len(_registered)
    try:
        content = path.read_bytes()
        file = PluginFile(path, hashlib.sha256(content).hexdigest())
        module = ModuleType(f"dancedata_plugin_{file.sha256[:16]}")
        module.__file__ = str(path)
        _files[module.__name__], sys.modules[module.__name__] = file, module
        cloudpickle.register_pickle_by_value(module)
        exec(compile(content, str(path), "exec"), module.__dict__)  # noqa: S102  (the user named the file)
    except DanceDataError as error:
        error.where = error.where or path
        raise
    except (Exception, SystemExit) as error:  # a script ends the process, without a word
        found = f"{type(error).__name__}: {error}"
        raise UsageError("the plug-in file cannot be loaded", where=path, found=found) from error
    if len(_registered) == n_before:
        fix = "dancedata init NAME --plugin-kind KIND writes an example"
        raise UsageError("the file registers no plug-in", where=path, fix=fix)
    return file


def plugin_file(cls: type[Any]) -> PluginFile | None:
    """Return the file that defines a class of a plug-in; None for those of dancedata and of other distributions."""
    return _files.get(cls.__module__)


def note_registered(cls: type[Any], kind: str, name: str) -> None:
    """Remember what a local file registers; UsageError if another one of the same call has registered the name."""
    file = plugin_file(cls)
    if file is not None and _registered.setdefault((kind, name), cls.__module__) != cls.__module__:
        other = _files[_registered[kind, name]]
        raise UsageError(f"two files register the {kind} {name!r}", found=f"{other.path} and {file.path}")


def without_file_key(cls: type[Any], parameters: dict[str, Any], where: str) -> dict[str, Any]:
    """Return parameters of a recipe without the hash of the plug-in's file; UsageError if it is another file's."""
    if FILE_KEY not in parameters:
        return parameters
    file = plugin_file(cls)
    stated = parameters[FILE_KEY]
    if file is None or file.sha256 != stated:
        raise UsageError("the plug-in is not the one that the dataset was built with", where=where,
                         found="one of no local file" if file is None else f"{file.path}, SHA-256 {file.sha256}",
                         allowed=f"the file with the SHA-256 {stated}", fix=_LOAD)  # fmt: skip
    return {key: value for key, value in parameters.items() if key != FILE_KEY}


def unknown_plugin(
    kind: str, name: str, parameters: object, known: Iterable[str], also: Iterable[str] = ()
) -> UsageError:
    """Return the error for an unknown name; parameters of a stored recipe tell whether it was a local plug-in."""
    if isinstance(parameters, dict) and FILE_KEY in parameters:
        return UsageError(f"the {kind} {name!r} is a local plug-in, which is not loaded",
                          allowed=f"the file with the SHA-256 {parameters[FILE_KEY]}", fix=_LOAD)  # fmt: skip
    return UsageError(f"unknown {kind} {name!r}", fix=did_you_mean(name, known, also))
