"""The result of comparing a copy of a dataset with what was published."""

from dataclasses import dataclass

from dancedata.core.text import listed

#: Missing names in a sentence.
_NAMED = 20


@dataclass(frozen=True)
class Compared:
    """Published files of one kind, and those that a copy lacks.

    Attributes
    ----------
    kind
        Plural: "motions", "songs".
    published
        Number of published files.
    missing
        Names without suffix, sorted; those of empty files too.
    unused
        Those of `missing` that no build uses, such as those of an ignore list.
    source
        Where the published names are from.
    empty
        Those of `missing` whose file is there and has no bytes, as downloads leave it that fail.
    """

    kind: str
    published: int
    missing: tuple[str, ...]
    unused: frozenset[str]
    source: str
    empty: frozenset[str] = frozenset()

    def __str__(self) -> str:
        if not self.missing:
            return f"Complete: all {self.published:,} {self.kind} are here (names: {self.source})."
        needed = [name for name in self.missing if name not in self.unused]
        count = f"{len(self.missing):,} of {self.published:,} {self.kind} are missing"
        count += f", {len(self.empty):,} of them empty files" if self.empty else ""
        if not needed:
            return f"Complete except for ignored files: {count}, all on the ignore list (names: {self.source})."
        ignored = f", {len(self.unused):,} of them on the ignore list" if self.unused else ""
        names = listed(needed, _NAMED)
        return f"Incomplete: {count}{ignored}: {names} (names: {self.source})."
