"""Copies of published datasets against the published files, by ``manifests/originals.yaml``."""

import functools
import hashlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.originals import Compared
from dancedata.core.resources import resource
from dancedata.core.text import listed
from dancedata.datasets.files import MAX_LIST_BYTES
from dancedata.files.regular_file import read_regular


@dataclass(frozen=True)
class Original:
    """The files of one published dataset.

    Attributes
    ----------
    names
        Names of the files of each kind (motions, songs, labels), without suffix.
    sources
        Where the names of each kind are from.
    lists
        SHA-256 of published lists, by file.
    """

    names: Mapping[str, frozenset[str]]
    sources: Mapping[str, str]
    lists: Mapping[str, str]

    def compare(self, kind: str, present: Iterable[tuple[str, Path]], unused: Collection[str] = ()) -> Compared:
        """Compare the names of a copy with the published ones; empty files are not there.

        Parameters
        ----------
        kind
            One of `names`.
        present
            Names that the copy has, with their files; others than the published ones do not count.
        unused
            Names that no build uses, such as those of an ignore list.
        """
        files = [(name, path) for name, path in present if name in self.names[kind]]
        filled = {name for name, path in files if path.stat().st_size}
        missing = self.names[kind] - filled
        empty = missing.intersection(name for name, _ in files)
        return Compared(
            kind, len(self.names[kind]), tuple(sorted(missing)), missing & set(unused), self.sources[kind], empty
        )

    def lists_note(self, paths: Mapping[str, Path]) -> str:
        """Return which lists of a copy are the published ones, byte for byte; "" if it has none.

        Parameters
        ----------
        paths
            Path of each list that may be in the copy, by its name in `lists`.
        """
        same = {name: _sha256(path) == self.lists[name] for name, path in paths.items() if path.is_file()}
        equal = [name for name, is_same in same.items() if is_same]
        others = [name for name, is_same in same.items() if not is_same]
        parts = [f"as published, by SHA-256: {listed(equal)}"] if equal else []
        parts += [f"differ from the published ones: {listed(others)}"] if others else []
        return f"Lists {'; '.join(parts)}." if parts else ""


@functools.cache
def _manifest() -> dict[str, Any]:
    import yaml

    content: dict[str, Any] = yaml.safe_load(resource("manifests", "originals.yaml").read_text(encoding="utf-8"))
    return content


def original(dataset: str) -> Original:
    """Return the published files of a dataset."""
    entries = dict(_manifest()[dataset])
    lists = entries.pop("lists", {}).get("sha256", {})
    texts = {kind: entries[entry.get("same_as", kind)]["names"] for kind, entry in entries.items()}
    names = {kind: frozenset(text.split()) for kind, text in texts.items()}
    return Original(names, {kind: entry["source"] for kind, entry in entries.items()}, lists)


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(read_regular(path, MAX_LIST_BYTES)).hexdigest()
    except OSError:
        return ""
