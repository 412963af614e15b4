"""Permission to publish a dataset: the licences of its source, of its clips and of its words decide."""

from __future__ import annotations

from typing import NamedTuple

from dancedata.core.errors import UsageError
from dancedata.core.licence import Licence
from dancedata.core.registry import DATASETS
from dancedata.core.terms import clips_by_terms
from dancedata.core.text import counted, quoted, shown
from dancedata.kernel import Store

#: Most characters of a clause.
_CLAUSE = 600


class Restriction(NamedTuple):
    """Content that a licence does not allow to be passed on, and the clause of the licence."""

    what: str
    clause: str

    def __str__(self) -> str:
        return f"{self.what}: {self.clause}"


def restrictions(store: Store) -> list[Restriction]:
    """Return what no licence is known to let anybody pass on; rows of audio features count as music."""
    return [*_of_dataset(store), *_of_clips(store), *_of_words(store)]


def require_permission(store: Store, *, to: object) -> None:
    """Raise UsageError with the clauses if a licence does not allow the dataset to be published."""
    forbidden = restrictions(store)
    if forbidden:
        name = store.info.get("source", {}).get("reader", "")
        lines = "\n".join(f"  - {restriction}" for restriction in forbidden)
        raise UsageError(
            "the terms of the source do not allow this dataset to be passed on, or do not state it",
            where=str(store.path),
            found=f"dataset {quoted(name)}, which holds\n{lines}\n",
            fix=f"publish what rebuilds it from the user's own copy of the source: dancedata push {store.path} {to} "
            f'--recipe-only. If you hold the right to publish the data, state it: --rights "..."{_in_manifest(name)}',
        )


def _in_manifest(dataset: str) -> str:
    """Return where the user states the terms of clips, for datasets that have a list of them; else ""."""
    if dataset not in DATASETS.names() or not DATASETS.get(dataset).explicit_only:
        return ""
    return "; or state the licence of each clip in the manifest's column licence, and build again"


def _of_dataset(store: Store) -> list[Restriction]:
    terms = clips_by_terms(store) or {None: 1}
    if all(licence is not None and licence.text for licence in terms):
        return []
    name = str(store.info.get("source", {}).get("reader", ""))
    reader = DATASETS.get(name) if name in DATASETS.names() else None
    text = str(store.info.get("licence") or "")
    allowed = {
        "motion": Licence(text).may_share or (reader is not None and reader.may_share_motion),
        "music": Licence(text).may_share or (reader is not None and reader.may_share_audio),
    }
    held = {"motion": "motion"}
    fields = [field for field in store.fields if store.field(field).kind == "audio"]
    if fields:
        held["music"] = f"features of music ({', '.join(fields)})"
    forbidden = [what for kind, what in held.items() if not allowed[kind]]
    clause = shown(text or "no licence is recorded", _CLAUSE)
    return [Restriction(" and ".join(forbidden), clause)] if forbidden else []


def _of_clips(store: Store) -> list[Restriction]:
    return [
        Restriction(counted(n, "clip"), shown(licence.text, _CLAUSE))
        for licence, n in clips_by_terms(store).items()
        if licence is not None and licence.text and not licence.may_share
    ]


def _of_words(store: Store) -> list[Restriction]:
    named = [layer for layer in store.layers if layer.licence]
    return [
        Restriction(f"words or events ({layer.name})", shown(layer.licence, _CLAUSE))
        for layer in named
        if not Licence(layer.licence).may_share
    ]
