"""Plug-ins in single Python files that a recipe, an option or a call names: local plug-ins.

A file becomes a module whose name has the hash of its bytes: two versions of a file are two modules. The hash is part
of the documents of its plug-ins (`dancedata.recipes.documents`), and with them of cache keys and of a recipe's hash.
Files are executed only where `load_plugins` names them, and in worker processes of such a process.
"""

from __future__ import annotations

import hashlib
import importlib
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from dancedata.core.errors import DanceDataError, UsageError, did_you_mean
from dancedata.core.typing import override

#: Key of the hash of a plug-in's file among its parameters, in the documents of recipes.
FILE_KEY = "plugin_sha256"
_PREFIX = "dancedata_plugin_"
_DIGITS = 16
_LOAD = "load the file: --plugin FILE, or dancedata.load_plugins(FILE) in Python"


@dataclass(frozen=True)
class PluginFile:
    """A file with plug-ins.

    Attributes
    ----------
    path
        Where it was read, absolute.
    sha256
        Hash of its bytes.
    """

    path: Path
    sha256: str

    @property
    def module(self) -> str:
        """Name of its module."""
        return f"{_PREFIX}{self.sha256[:_DIGITS]}_{re.sub(r'[^A-Za-z0-9_]', '_', self.path.stem)}"


#: Files by the names of their modules, and what each registers: kind, name and the call that registers it again.
_files: dict[str, PluginFile] = {}
_registered: dict[str, dict[tuple[str, str], Callable[[], Any]]] = {}


class _Modules(MetaPathFinder, Loader):
    """Imports the modules of `_files`; unpickling a plug-in imports its module in a worker process, too."""

    @override
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> Any:
        file = _files.get(fullname)
        return None if file is None else ModuleSpec(fullname, self, origin=str(file.path))

    @override
    def exec_module(self, module: ModuleType) -> None:
        file = _files[module.__name__]
        content = _read(file.path)
        if hashlib.sha256(content).hexdigest() != file.sha256:
            raise UsageError(
                "the plug-in file changed after it was loaded", where=file.path, fix="run the same command again"
            )
        module.__file__ = str(file.path)
        exec(compile(content, str(file.path), "exec"), module.__dict__)  # noqa: S102  (the user named the file)


def load_plugins(*files: str | Path) -> tuple[PluginFile, ...]:
    """Load local plug-ins: Python files that register some, as ``plugins:`` of a recipe and ``--plugin`` do.

    The files are executed. Plug-ins replace those of the same kind and name of files that were loaded before, such as
    an earlier version of the file; those of dancedata and of other distributions cannot be replaced. A file cannot
    import others next to it: put several files into a package.

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
    if _finder not in sys.meta_path:
        sys.meta_path.append(_finder)
    loaded: dict[tuple[str, str], PluginFile] = {}
    for name in dict.fromkeys(Path(file).expanduser().absolute() for file in files):
        file = PluginFile(name, hashlib.sha256(_read(name)).hexdigest())
        for key in _load(file):
            other = loaded.setdefault(key, file)
            if other.sha256 != file.sha256:
                raise UsageError(f"two files register the {key[0]} {key[1]!r}", found=f"{other.path} and {name}")
    return tuple(dict.fromkeys(loaded.values()))


def _load(file: PluginFile) -> Iterable[tuple[str, str]]:
    _files[file.module] = file
    try:
        importlib.import_module(file.module)
    except DanceDataError as error:
        error.where = error.where or file.path
        raise
    except (Exception, SystemExit) as error:  # a script ends the process, without a word
        raise UsageError(
            "the plug-in file cannot be loaded", where=file.path, found=f"{type(error).__name__}: {error}"
        ) from error
    registered = _registered.get(file.module, {})
    if not registered:
        raise UsageError(
            "the file registers no plug-in", where=file.path, fix="dancedata new KIND NAME writes an example"
        )
    for register in registered.values():
        register()
    return tuple(registered)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UsageError("the plug-in file cannot be read", where=path, found=str(error)) from error


_finder = _Modules()


def plugin_file(cls: type[Any]) -> PluginFile | None:
    """Return the file that defines a class of a plug-in; None for those of dancedata and of other distributions."""
    return _files.get(cls.__module__)


def is_local(cls: type[Any]) -> bool:
    """Return whether a class is defined in a local file."""
    return cls.__module__ in _files


def note_registered(cls: type[Any], kind: str, name: str, register: Callable[[], Any]) -> None:
    """Remember the plug-ins that a local module registers; do nothing for other modules."""
    if is_local(cls):
        _registered.setdefault(cls.__module__, {})[kind, name] = register


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


class KnownFiles:
    """The files of this process. Unpickled in another process, it makes them known there, for what follows it.

    There a file is executed when the first plug-in of it is unpickled; one that has changed by then is an error.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _known_files, (tuple(_files.values()),)


def _known_files(files: Iterable[PluginFile]) -> KnownFiles:
    _files.update({file.module: file for file in files})
    if _finder not in sys.meta_path:
        sys.meta_path.append(_finder)
    return KnownFiles()


def with_known_files(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that can be sent, with its arguments after it, to processes that know no local plug-in."""
    return _Function(KnownFiles(), function) if _files else function


@dataclass(frozen=True)
class _Function:
    files: KnownFiles  # first: it is unpickled before the function and its arguments
    function: Callable[..., Any]

    def __call__(self, *args: Any) -> Any:
        return self.function(*args)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Function, (self.files, self.function)
