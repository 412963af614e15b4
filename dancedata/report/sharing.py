"""What splits share: songs, dancers, and clips by their copies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dancedata.store import ClipView, Store

__all__ = ["splits"]


def splits(store: Store) -> dict[str, Any]:
    """Return the section of the document: for each two splits how much both have, and the names of it.

    A song or a clip that train shares with another split is a leak; val and test may share songs, as in AIST++.
    """
    origin = {c.id: c.source or c.id for c in store.clips}
    return {
        "songs": _shared(store, lambda c: c.music),
        "dancers": _shared(store, lambda c: c.dancer),
        "clips": _shared(store, lambda c: origin[c.id]),
    }


def _shared(store: Store, key: Callable[[ClipView], str]) -> dict[str, Any]:
    names = {split: {key(c) for c in store.clips if c.split == split and key(c)} for split in store.splits}
    counts = {a: {b: len(names[a] & names[b]) for b in store.splits} for a in store.splits}
    both = [(a, b) for i, a in enumerate(store.splits) for b in store.splits[i + 1 :]]
    listed = {f"{a} and {b}": sorted(names[a] & names[b]) for a, b in both if names[a] & names[b]}
    return {"counts": counts, "names": listed}
