"""dancedata pull: fetches the files of a dataset at an address before they are needed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import counted, size_text
from dancedata.files.addresses import is_address, origin_of
from dancedata.kernel import DatasetFiles, Progress
from dancedata.remote.address import ALLOWED
from dancedata.remote.cached import fetch_files, folder_of_address
from dancedata.remote.fetch import has_file

#: Files that are fetched at once.
_JOBS = 6


@dataclass(frozen=True)
class Pulled:
    """Result of `pull`: the folder in the cache, the address with the commit, files and bytes, and those fetched."""

    path: Path
    address: str
    files: int
    bytes: int
    fetched_files: int
    fetched_bytes: int

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__, "path": str(self.path)}

    def __str__(self) -> str:
        fetched = f"fetched {counted(self.fetched_files, 'file')}, {size_text(self.fetched_bytes)}"
        return f"{self.address}: {counted(self.files, 'file')}, {size_text(self.bytes)}; {fetched}\n{self.path}"


def pull(
    address: str | Path,
    split: str | Sequence[str] | None = None,
    *,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Pulled:
    """Fetch the files of a dataset into the cache, six at once, each compared with its hash.

    `split`: Only these splits; default: all.
    `cache`: Folder of the cache; default: that of `dancedata.open`.
    """
    if not is_address(address):
        raise UsageError("not an address of a dataset", found=str(address), allowed=ALLOWED)
    folder = folder_of_address(address, None if cache is None else Path(cache).expanduser().absolute())
    listing = DatasetFiles.read(folder)
    splits = None if split is None else (split,) if isinstance(split, str) else tuple(split)
    for name in splits or ():
        if name not in listing.splits:
            raise UsageError(f"no split named {name!r}", where=str(address), fix=did_you_mean(name, listing.splits))
    files = listing.files(splits)
    missing = [file for file in files if not has_file(folder / file.file, file.size)]
    fetched = fetch_files(folder, missing, Progress(quiet=not progress), _JOBS) if missing else 0
    origin = origin_of(folder)
    shown = str(address) if origin is None else origin.address
    return Pulled(folder, shown, len(files), sum(file.size for file in files), len(missing), fetched)


def fetch_all(folder: Path) -> None:
    """Fetch the missing files of a dataset of the cache."""
    files = DatasetFiles.read(folder).files()
    missing = [file for file in files if not has_file(folder / file.file, file.size)]
    if missing:
        fetch_files(folder, missing, jobs=_JOBS)
