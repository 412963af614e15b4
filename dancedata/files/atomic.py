"""Files that appear whole or not at all."""

import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError
from dancedata.core.system import flush_folder, umask

#: Prefix of the names of temporary files and folders.
PREFIX = ".dancedata-"
#: Endings of what always has one format.
_ENDINGS = {"report": (".html", ".htm"), "page": (".html", ".htm"), "card": (".md",)}
_TEMPORARY = re.compile(r"\.dancedata-[a-z0-9_]{8}\.tmp")


def is_temporary(name: str) -> bool:
    """Return whether a name is one that `atomic_file` gives."""
    return _TEMPORARY.fullmatch(name) is not None


def require_free(path: Path, stores: Iterable[Path], what: str, *, overwrite: bool) -> Path:
    """Return the path of a file to write, without "~"."""
    path = path.expanduser()
    if any(path.resolve().is_relative_to(store.expanduser().resolve()) for store in stores):
        raise UsageError(f"a {what} cannot be written into a dataset, whose files are listed", where=path,
                         fix="choose a file outside of the dataset")  # fmt: skip
    if path.is_dir() or not path.absolute().parent.is_dir():
        problem = "this is a folder" if path.is_dir() else "the folder of this file does not exist"
        raise UsageError(problem, where=path, fix="name a file in a folder that exists")
    endings = _ENDINGS.get(what, ())
    if endings and path.suffix.lower() not in endings:
        problem, allowed = f"a {what} is not a file of this kind", f"a name that ends in {endings[0]}"
        raise UsageError(problem, where=path, found=path.suffix or "no ending", allowed=allowed)
    if os.path.lexists(path) and not overwrite:
        raise already_there(path)
    return path


def already_there(path: Path) -> UsageError:
    """Return the error for a file or folder that may not be replaced."""
    return UsageError("the file is already there", where=path, fix="choose another name, or overwrite=True",
                      options="choose another name, or add --overwrite")  # fmt: skip


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; on success it becomes `path`, flushed; else it is removed."""
    handle, name = tempfile.mkstemp(prefix=PREFIX, suffix=".tmp", dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        # mkstemp makes files that only their owner can read; datasets are shared.
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, path)
    except BaseException:
        with suppress(FileNotFoundError):
            temporary.unlink()
        raise
    flush_folder(path.parent)


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes atomically."""
    with atomic_file(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    r"""Write UTF-8 text atomically; characters that are not valid Unicode are written as ``\udcff``."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, obj: Any) -> None:
    """Write indented JSON with sorted keys, atomically."""
    text = json.dumps(obj, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def dump_json(obj: Any) -> str:
    """Return indented JSON: UTF-8, keys in the order given, no NaN."""
    return json.dumps(obj, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def dump_lines(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return one JSON object per line, keys sorted."""
    return "".join(json.dumps(dict(row), ensure_ascii=False, allow_nan=False, sort_keys=True) + "\n" for row in rows)
