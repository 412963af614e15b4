"""Permission to copy music into a page or a video: its licence decides, not the person at the keyboard."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from dancedata.core.errors import UsageError
from dancedata.core.licence import Licence
from dancedata.core.registry import DATASETS
from dancedata.core.text import counted, listed, shown

#: The option by which a user states the right to share music.
OVERRIDE = "--rights TEXT"
#: Most characters of a licence in a message or notice.
_LICENCE = 600


class Dataset(Protocol):
    """An open dataset: its folder, dataset.json, terms of clips, and clips."""

    path: Path
    info: Mapping[str, Any]

    @property
    def licences(self) -> tuple[Licence, ...]:
        """Terms of clips that differ from the dataset's."""

    def __iter__(self) -> Iterator[Any]: ...


def clips_by_terms(store: Dataset) -> dict[Licence | None, int]:
    """Return the number of clips, without copies, of each of `Store.licences`; None: those of the dataset."""
    if not store.licences:
        return {}
    numbers = Counter(clip.licence for clip in store if not clip.source)
    terms = {k: licence for k, licence in enumerate(store.licences)}
    return {terms.get(k): numbers[k] for k in sorted(numbers, key=lambda k: (k < 0, k))}


def terms_text(terms: dict[Licence | None, int]) -> list[str]:
    """Return a line for each entry of `clips_by_terms`."""
    return [
        f"{counted(n, 'clip')}: "
        + (
            "the licence of the dataset" if licence is None
            else f"{licence.text or 'the licence of the dataset'}"
            f"{f'; cite: {licence.citation}' if licence.citation else ''}"
            f"; {'may' if licence.may_share else 'may not'} be passed on"
        )
        for licence, n in terms.items()
    ]  # fmt: skip


def may_share_audio(store: Dataset) -> bool:
    """Return whether the strictest licence of a dataset allows its music to be passed on; False where unknown."""
    name = store.info.get("source", {}).get("reader", "")
    of_dataset = name in DATASETS.names() and DATASETS.get(name).may_share_audio
    terms = clips_by_terms(store) or {None: 1}
    return all(of_dataset if licence is None or not licence.text else licence.may_share for licence in terms)


def require_shareable(store: Dataset, *, rights: str | None = None) -> str:
    """Return the notice that goes with a copy of music; UsageError unless licence or `rights` allow one."""
    licence = shown(store.info.get("licence", "unknown"), _LICENCE)
    terms = clips_by_terms(store)
    if terms:
        strict = {k: n for k, n in terms.items() if k is None or not k.may_share} or terms
        licence = shown(f"{licence.rstrip('.')}; {listed(terms_text(strict), 4)}", 2 * _LICENCE)
    if may_share_audio(store):
        return f"Music: {licence}"
    if rights is None:
        raise UsageError("the licence of this dataset does not allow its music to be passed on",
                         where=str(store.path), found=f"licence: {licence.rstrip('.')}",
                         allowed="music that may be copied to others, such as that of the demo",
                         fix=f"leave the music out, or state your right: {OVERRIDE}")  # fmt: skip
    stated = f"included on the statement of the maker of this file that it may be shared: {rights}"
    return f"Music: {stated}. Licence: {licence}"
