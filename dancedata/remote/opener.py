"""What opens addresses: datasets in the cache, fetched file by file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from dancedata.core.typing import override
from dancedata.files.addresses import OPENERS, Opener
from dancedata.remote.cached import fetch, folder_of_address, prefetch
from dancedata.remote.pull import fetch_all


@OPENERS.register("remote")
@dataclass(frozen=True)
class RemoteOpener(Opener):
    """Hubs, buckets and servers."""

    version: ClassVar[int] = 1

    @override
    def folder(self, address: str | Path) -> Path:
        return folder_of_address(address)

    @override
    def fetch(self, path: Path) -> None:
        fetch(path)

    @override
    def prefetch(self, paths: Sequence[Path]) -> None:
        prefetch(paths)

    @override
    def fetch_all(self, folder: Path) -> None:
        fetch_all(folder)
