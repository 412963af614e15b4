"""Whether music may be copied into a page or a video: its licence decides, not the person at the keyboard."""

from dancedata.core.errors import UsageError
from dancedata.core.registry import DATASETS
from dancedata.core.text import quoted, shown
from dancedata.store.dataset import Store

#: The option by which a user states the right to share music.
OVERRIDE = "--i-may-share-this-music"
#: Most characters of a licence in a message or notice.
_LICENCE = 600


def may_share_audio(store: Store) -> bool:
    """Return whether the licence of a dataset's source allows its music to be passed on; False where unknown."""
    name = store.meta.get("dataset", "")
    return name in DATASETS.names() and DATASETS.get(name).may_share_audio


def require_shareable(store: Store, *, allowed_by_caller: bool = False) -> str:
    """Return the notice that goes with a copy of the music: one sentence with the licence as the dataset states it.

    UsageError if the licence does not allow to pass the music on, and the caller does not state the right to do so.
    """
    licence = shown(store.meta.get("licence", "unknown"), _LICENCE)
    if may_share_audio(store):
        return f"Music: {licence}"
    if not allowed_by_caller:
        raise UsageError(
            "the licence of this dataset does not allow its music to be passed on",
            where=str(store.path),
            found=f"dataset {quoted(store.meta.get('dataset', ''))}, licence: {licence.rstrip('.')}",
            allowed="music that may be copied to others, such as that of the demo",
            fix=f"leave the music out, or state that you hold the right to share it: {OVERRIDE}",
        )
    return f"Music: included on the statement of the maker of this file that it may be shared. Licence: {licence}"
