"""The entries of a reader's `fields`, sorted by kind and checked against the dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import shown
from dancedata.store.clip_columns import FREE
from dancedata.store.dataset import Store
from dancedata.torch.options import Item, Primitives, Relative, Segments, Text, clash

#: Fields that are read by default.
_USUAL = ("edge151", "librosa35")


@dataclass(frozen=True)
class SampleItems:
    """What a sample holds; `words` are the text or the segments."""

    fields: tuple[str, ...]  # names of the fields that rows are read of
    relative: tuple[str, ...]  # those of them whose translation is relative to the window's first frame
    columns: tuple[str, ...]  # names of free columns
    primitives: Primitives | None
    words: Text | Segments | None

    @classmethod
    def of(cls, store: Store, items: Sequence[Item] | str | None) -> SampleItems:
        """Sort the entries, by default edge151 and librosa35, else all fields; UsageError if they do not fit."""
        if items is None:
            items = _USUAL if set(_USUAL) <= set(store.fields) else tuple(store.fields)
        items = tuple(items) if isinstance(items, Iterable) and not isinstance(items, str) else (items,)
        names, relative = list[str](), list[str]()
        primitives, words = list[Primitives](), list[Text | Segments]()
        for item in items:
            if isinstance(item, Primitives):
                primitives.append(item)
            elif isinstance(item, Text | Segments):
                words.append(item)
            elif isinstance(item, str | Relative):
                names.append(item if isinstance(item, str) else item.field)
                relative += [] if isinstance(item, str) else [item.field]
            else:
                raise UsageError("an entry of fields is neither a name nor one of the values", found=shown(item),
                                 allowed="names, Relative, Primitives, Text, Segments")  # fmt: skip
        for single in (primitives, words):
            if len(single) > 1:
                raise clash(single[0], single[1], "a sample has one of these")
        stored = tuple(name for name in names if not name.startswith(FREE))
        if not stored or len(set(names)) < len(names):
            raise UsageError(
                "fields must name at least one field, each once", found=", ".join(map(repr, items)) or None
            )
        for name in stored:
            if name not in store.fields:
                raise _missing_field(store, name)
        columns = tuple(name for name in names if name.startswith(FREE))
        return cls(stored, tuple(relative), columns, next(iter(primitives), None), next(iter(words), None))

    def require_plain(self, reader: str) -> None:
        """Raise UsageError for entries that only a `WindowDataset` has."""
        for item in (*map(Relative, self.relative), *([self.primitives] if self.primitives is not None else [])):
            raise clash(item, reader, "it is made of windows of one dancer each: read them with a WindowDataset")


def _missing_field(store: Store, name: str) -> UsageError:
    """Return the error of a field that the dataset lacks; it names the shipped recipes that compute the field."""
    from dancedata.files.yaml import recipes_with  # here, as readers need no YAML

    makers = recipes_with(name)
    build = (
        f"name fields that the dataset has, or build with a recipe that has it, such as {' or '.join(makers)}, or "
    )
    fix = f"{build}add it to your own recipe" if makers else did_you_mean(name, store.fields)
    return UsageError(
        f"the dataset has no field {name!r}", where=str(store.path), found=", ".join(store.fields), fix=fix
    )
