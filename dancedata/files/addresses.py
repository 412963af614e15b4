"""Addresses of datasets: what has a scheme is brought into the cache by an opener; everything else is a path.

A dataset of an address is CACHE/datasets/SELF_SHA256/, with the address in a file beside the folder. It is a dataset
like any other, of which a file is fetched when it is first opened.
"""

import re
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.plugins import Plugin
from dancedata.core.registry import Registry
from dancedata.files.cache_files import DATASETS
from dancedata.files.strict_json import read_json

# A Path has one slash after the colon.
_SCHEME = re.compile(r"(?P<scheme>[a-z][a-z0-9+.-]+):/{1,2}(?=[^/])", re.IGNORECASE)
_HASH = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Origin:
    """Origin of a dataset of the cache: its address, of a hub with the commit, and the address as it was given."""

    address: str
    requested: str


class Opener(Plugin):
    """Brings datasets of addresses into the cache."""

    @abstractmethod
    def folder(self, address: str | Path) -> Path:
        """Return the folder of a dataset in the cache, whose dataset.json is there; UsageError for a bad address."""

    @abstractmethod
    def fetch(self, path: Path) -> None:
        """Fetch a file of a dataset of the cache, or wait for who does."""

    @abstractmethod
    def prefetch(self, paths: Sequence[Path]) -> None:
        """Fetch files of one dataset in the background, in this order."""

    @abstractmethod
    def fetch_all(self, folder: Path) -> None:
        """Fetch all missing files of a dataset."""


OPENERS = Registry("opener of addresses", "dancedata.remote", Opener)


def is_address(path: object) -> bool:
    """Return whether a path is an address instead of a local path."""
    return isinstance(path, str | Path) and _SCHEME.match(str(path)) is not None


def path_text(path: str | Path) -> str:
    """Return a path as it was given: of an address a Path has one slash after the colon."""
    match = _SCHEME.match(str(path))
    return str(path) if match is None else f"{match['scheme']}://{str(path)[match.end() :]}"


def local_folder(path: str | Path) -> Path:
    """Return the folder of a dataset: a local path as it is, with ~ expanded; for an address one in the cache."""
    return OPENERS.only().folder(path) if is_address(path) else Path(path).expanduser()


def origin_of(folder: Path) -> Origin | None:
    """Return where a dataset comes from; None for a folder that is not of the cache."""
    if not _HASH.fullmatch(folder.name) or folder.parent.name != DATASETS:
        return None
    try:
        return Origin(**read_json(folder.with_name(f"{folder.name}.json"), 1 << 16))
    except (OSError, ValueError, TypeError):
        return None


def require_file(path: Path) -> None:
    """Fetch a file of a dataset of the cache if it is not there; nothing for other folders."""
    if not path.exists() and origin_of(path.parent) is not None:
        OPENERS.only().fetch(path)


def prefetch(paths: Sequence[Path]) -> None:
    """Fetch files of one dataset of the cache in the background, in this order; nothing for other folders."""
    missing = [path for path in paths if not path.exists()]
    if missing and origin_of(missing[0].parent) is not None:
        OPENERS.only().prefetch(missing)


def require_whole(folder: Path) -> None:
    """Fetch the missing files of a dataset of the cache; nothing for other folders."""
    if origin_of(folder) is not None:
        OPENERS.only().fetch_all(folder)
