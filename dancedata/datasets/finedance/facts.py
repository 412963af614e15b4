"""Facts about FineDance: ids, splits, ignore lists, trims, genres, from ``manifests/finedance.yaml``."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass

from dancedata.core.grid import FrameGrid
from dancedata.core.resources import manifest

#: Largest difference between motion and music in the published files, in frames, as reported by users.
MAX_DIFFERENCE = 2


@dataclass(frozen=True)
class Protocol:
    """One of the two ways to split the dataset; train is the remainder."""

    val: frozenset[str]
    test: frozenset[str]


@dataclass(frozen=True)
class IgnoreList:
    """Ids that a published code leaves out, and the splits in which this reader does so too."""

    ids: frozenset[str]
    applies_to: tuple[str, ...]
    source: str


@dataclass(frozen=True)
class Trim:
    """Number of frames at the beginning that should be trimmed, and the reason."""

    frames: int
    reason: str
    source: str


@dataclass(frozen=True)
class Facts:
    """The content of the manifest.

    `ids`: All published ids, "001" to "211".
    `protocols`, `ignore_lists`: By name.
    `genre_ids`: Lodge's number of each genre, by its canonical name.
    `genre_names`: Canonical name of each genre in the labels; keys are case-folded.
    """

    ids: tuple[str, ...]
    frame_rate: int
    protocols: Mapping[str, Protocol]
    ignore_lists: Mapping[str, IgnoreList]
    trims: Mapping[str, Trim]
    genre_ids: Mapping[str, int]
    genre_names: Mapping[str, str]

    def genre(self, style: str) -> str:
        """Return the canonical name of a genre in the labels, "" if it is not one of the sixteen."""
        return self.genre_names.get(_fold(style), "")

    def ignored(self, protocol: str) -> frozenset[str]:
        """Return the ids on the ignore lists of a protocol."""
        return frozenset().union(*(i.ids for i in self.ignore_lists.values() if protocol in i.applies_to))

    def listed(self, protocol: str, clip: str) -> str:
        """Return "val" or "test" if the protocol lists the id there, ignored or not; else ""."""
        lists = self.protocols[protocol]
        return "val" if clip in lists.val else "test" if clip in lists.test else ""

    def lists(self, clip: str) -> tuple[str, ...]:
        """Return all lists that contain the id: ``cross_genre.train``, ``cross_dancer.val``, ``ignored``, ...

        An id is in a protocol's train list if the protocol neither lists it elsewhere nor ignores it, as in the
        code of Lodge and FineDance.
        """
        names = []
        for protocol in self.protocols:
            split = self.listed(protocol, clip)
            if split or clip not in self.ignored(protocol):
                names.append(f"{protocol}.{split or 'train'}")
        return (*names, *(name for name, listed in self.ignore_lists.items() if clip in listed.ids))


@functools.cache
def facts() -> Facts:
    """Read the manifest of FineDance, once."""
    raw = manifest("finedance")
    grid = FrameGrid.of(raw["frame_rate"])
    names = {_fold(name): genre for genre, entry in raw["genres"].items() for name in (genre, *entry.get("also", ()))}
    return Facts(
        ids=tuple(f"{n:03d}" for n in range(1, raw["sequences"] + 1)),
        frame_rate=raw["frame_rate"],
        protocols={name: Protocol(frozenset(p["val"]), frozenset(p["test"])) for name, p in raw["splits"].items()},
        ignore_lists={
            name: IgnoreList(frozenset(entry["ids"]), tuple(entry["applies_to"]), entry["source"])
            for name, entry in raw["ignore_lists"].items()
        },
        trims={
            t["id"]: Trim(t["frames"] if "frames" in t else grid.frames(t["seconds"]), t["reason"], t["source"])
            for t in raw["trims"]
        },
        genre_ids={genre: entry["id"] for genre, entry in raw["genres"].items()},
        genre_names=names,
    )


def _fold(style: str) -> str:
    return style.strip().casefold()
