"""Which split an AIST++ sequence belongs to, and which sequences are to be ignored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.text import listed, shown
from dancedata.datasets._source import describe, list_folder, read_names, relative
from dancedata.datasets.aistpp.facts import crossmodal_split, facts, parse_name
from dancedata.datasets.aistpp.layout import Folders

__all__ = ["ALL", "RULE", "SPLITS", "Ignored", "Splits", "find_ignored", "find_splits"]

SPLITS = ("train", "val", "test")
ALL = "all"
RULE = "crossmodal"
"""The only split that is known as a rule over the names."""
IGNORE_LIST = "ignore_list.txt"


@dataclass(frozen=True)
class Splits:
    """The chosen split: from files, or by rule (`of` is None), or one for all.

    Attributes
    ----------
    name : as in the recipe.
    of : sequence name -> split, from the files; None if the rule decides.
    expected : names that ought to have a pickle, from the split files or from ``cameras/mapping.txt``.
    notes : where all this came from.
    """

    name: str
    of: Mapping[str, str] | None
    expected: frozenset[str]
    notes: tuple[str, ...]

    def split(self, name: str) -> str:
        """Split of a sequence, "" if it is in none."""
        if self.name == ALL:
            return ALL
        if self.of is not None:
            return self.of.get(name, "")
        parsed = parse_name(name)
        return "" if parsed is None else crossmodal_split(parsed)


@dataclass(frozen=True)
class Ignored:
    """Names on the ignore list, and where it came from, for rejects and for notes."""

    names: frozenset[str]
    where: str
    notes: tuple[str, ...] = field(default=())


def find_splits(folders: Folders, name: str, split_dir: str | None) -> Splits:
    """Read the split files if one is there, else use the rule over the names.

    Raises
    ------
    SourceError
        If there is neither file nor rule, a file cannot be read, or a sequence is in two files.
    """
    if name == ALL:
        mapping, notes = _mapping(folders)
        return Splits(ALL, None, mapping, ("Splits: none asked for; every clip is in the split 'all'.", *notes))
    places = _split_places(folders, split_dir)
    for place in places:
        paths = {split: place / f"{name}_{split}.txt" for split in SPLITS}
        there = {split: path for split, path in paths.items() if path.is_file()}
        if there:
            return _from_files(folders, name, there)
    if name != RULE or split_dir is not None:
        _no_such_split(name, places, split_dir)
    mapping, notes = _mapping(folders)
    expected = Splits(RULE, None, frozenset(), ())
    first = f"Splits: no {name}_train.txt, _val or _test in splits/, so the crossmodal rule (by name) decides."
    return Splits(RULE, None, frozenset(n for n in mapping if expected.split(n)), (first, *notes))


def _split_places(folders: Folders, split_dir: str | None) -> list[Path]:
    """Folders that may hold split files, in order."""
    if split_dir is None:
        return [place / "splits" for place in folders.places if (place / "splits").is_dir()]
    # An absolute split_dir stays as it is when joined to a folder.
    custom = [place / Path(split_dir).expanduser() for place in reversed(folders.places)]
    there = [place for place in custom if place.is_dir()]
    if not there:
        raise SourceError(
            "aist++: the folder of the split files does not exist",
            where=str(custom[0]),
            allowed="a folder with NAME_train.txt, NAME_val.txt, NAME_test.txt",
            fix="correct split_dir: a folder relative to the source, or an absolute path",
        )
    return there


def _no_such_split(name: str, places: list[Path], split_dir: str | None) -> None:
    """Raise SourceError that names what was looked for and which splits are there."""
    found = {
        path.stem.removesuffix(f"_{split}")
        for place in places
        for path in list_folder(place)
        for split in SPLITS
        if path.suffix == ".txt" and path.stem.endswith(f"_{split}")
    }
    wanted = ", ".join(f"{name}_{split}.txt" for split in SPLITS)
    where = ", ".join(str(place) for place in places)
    allowed = sorted(found | ({RULE} if split_dir is None else set())) + ([ALL] if split_dir is None else [])
    raise SourceError(
        f"aist++: no split named {name!r}; looked for {wanted}",
        where=where or "no folder splits/ in the source",
        found=", ".join(describe(place) for place in places) or "no split file",
        allowed=listed(allowed, 20) or "a name that has files",
        fix="correct split in the recipe, or split_dir",
    )


def _from_files(folders: Folders, name: str, paths: Mapping[str, Path]) -> Splits:
    of: dict[str, str] = {}
    notes = []
    parts = []
    for split in SPLITS:
        if split not in paths:
            parts.append(f"no {name}_{split}.txt, so {split} is empty")
            continue
        names = read_names(paths[split])
        for sequence in dict.fromkeys(names):
            if sequence in of:
                raise SourceError(
                    f"aist++: the sequence {shown(sequence)} is in two splits",
                    where=f"{paths[of[sequence]]} and {paths[split]}",
                    fix="take it out of one of the files",
                )
            of[sequence] = split
        parts.append(f"{relative(paths[split], folders.source)} ({len(set(names)):,} names)")
        if len(set(names)) < len(names):
            notes.append(f"{paths[split].name} lists some names more than once; each counts once.")
    return Splits(name, of, frozenset(of), (f"Splits: {', '.join(parts)}.", *notes))


def _mapping(folders: Folders) -> tuple[frozenset[str], tuple[str, ...]]:
    """All names that ``cameras/mapping.txt`` lists, if it is there."""
    for place in folders.places:
        path = place / "cameras" / "mapping.txt"
        if path.is_file():
            names = frozenset(read_names(path))
            return names, (f"Names: {relative(path, folders.source)} lists {len(names):,} sequences.",)
    return frozenset(), ()


def find_ignored(folders: Folders, use: bool, split_dir: str | None) -> Ignored:
    """Read the first ignore list in the source, however empty; without one take the shipped list."""
    if not use:
        return Ignored(frozenset(), "", ("not applied, as asked for",))
    custom = _split_places(folders, split_dir) if split_dir is not None else []
    usual = [folder for place in folders.places for folder in (place, place / "splits")]
    paths = [folder / IGNORE_LIST for folder in (*custom, *usual)]
    lists = [(path, frozenset(read_names(path))) for path in paths if path.is_file()]
    if not lists:
        shipped = facts().ignored
        return Ignored(shipped, "the official list (shipped)", ("none in the source, so the official one is used",))
    path, names = lists[0]
    where = relative(path, folders.source)
    same = ", the official one" if names == facts().ignored else ""
    notes = [f"{where}{same}"]
    others = [relative(other, folders.source) for other, its in lists[1:] if its != names]
    if others:
        notes.append(f"not used: {listed(others)}, which says something else")
    return Ignored(names, where, tuple(notes))


def missing_motion(splits: Splits, ignored: Ignored, there: Iterable[str]) -> list[str]:
    """Names of the chosen splits that have no pickle, ignored ones excepted."""
    return sorted(splits.expected - ignored.names - set(there))
