"""What splits share: songs, dancers, and clips by their copies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from dancedata.store import ClipView, Store
from dancedata.store.songs import AlikeSongs, alike_songs, songs_of, sound_field

__all__ = ["splits"]


def splits(store: Store) -> dict[str, Any]:
    """Return the section of the document: for each two splits how much both have, and the names of it.

    A song or a clip that train shares with another split is a leak; val and test may share songs, as in AIST++.
    Songs are one by their name, by their samples, or by their sound.
    """
    origin = {c.id: c.source or c.id for c in store.clips}
    songs = songs_of(store.clips, store.meta)
    alike = None if sound_field(store) is None else alike_songs(store, songs)
    return {
        "compared_by_sound": alike is not None,
        "songs": _shared(store, lambda c: songs.get(c.id, ""), alike or ()),
        "dancers": _shared(store, lambda c: c.dancer),
        "clips": _shared(store, lambda c: origin[c.id]),
    }


def _shared(store: Store, key: Callable[[ClipView], str], alike: Sequence[AlikeSongs] = ()) -> dict[str, Any]:
    names = {split: {key(c) for c in store.clips if c.split == split and key(c)} for split in store.splits}
    both = {(a, b): sorted(names[a] & names[b]) for a in store.splits for b in store.splits}
    for pair in alike:
        for a, b in both:
            if a != b and any(a in one and b in other for one, other in (pair.splits, pair.splits[::-1])):
                both[a, b].append(f"{pair.songs[0]} (sounds as {pair.songs[1]}, likeness {pair.likeness:.2f})")
    counts = {a: {b: len(both[a, b]) for b in store.splits} for a in store.splits}
    later = [(a, b) for i, a in enumerate(store.splits) for b in store.splits[i + 1 :]]
    return {"counts": counts, "names": {f"{a} and {b}": both[a, b] for a, b in later if both[a, b]}}
