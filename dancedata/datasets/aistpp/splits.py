"""Splits of AIST++, from files or by rule, and its ignore list."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.text import counted, listed, shown
from dancedata.datasets.aistpp.facts import crossmodal_split, facts, parse_name
from dancedata.datasets.aistpp.layout import Folders
from dancedata.datasets.files import ALL, SPLITS, describe, list_folder, read_names, relative

#: The split that a rule over the names defines.
RULE = "crossmodal"
IGNORE_LIST = "ignore_list.txt"


@dataclass(frozen=True)
class Splits:
    """The chosen split: from files, or (`of` is None) by rule or a single one for all clips.

    Attributes
    ----------
    name
        The parameter in the recipe.
    of
        Sequence name -> split, from the files; None if the rule decides.
    expected
        Names that should have a pickle, from the split files or from ``cameras/mapping.txt``.
    notes
        The files that were read.
    """

    name: str
    of: Mapping[str, str] | None
    expected: frozenset[str]
    notes: tuple[str, ...]

    def split(self, name: str) -> str:
        """Return the split of a sequence, "" if it is in none."""
        if self.name == ALL:
            return ALL
        if self.of is not None:
            return self.of.get(name, "")
        parsed = parse_name(name)
        return "" if parsed is None else crossmodal_split(parsed)


@dataclass(frozen=True)
class Ignored:
    """Names on the ignore list, and its origin, for rejects and notes."""

    names: frozenset[str]
    where: str
    notes: tuple[str, ...] = field(default=())


def find_splits(folders: Folders, name: str, split_dir: str | None) -> Splits:
    """Read the split files if there are any, else use the rule over the names.

    Raises
    ------
    SourceError
        If there is neither a file nor a rule, a file cannot be read, or a sequence is in two files.
    """
    if name == ALL:
        mapping, notes = _mapping(folders)
        return Splits(ALL, None, mapping, ("Splits: none requested; every clip is in the split 'all'.", *notes))
    places = _split_places(folders, split_dir)
    for place in places:
        paths = {split: place / f"{name}_{split}.txt" for split in SPLITS}
        existing = {split: path for split, path in paths.items() if path.is_file()}
        if existing:
            return _from_files(folders, name, existing)
    if name != RULE or split_dir is not None:
        _no_such_split(name, places, split_dir)
    mapping, notes = _mapping(folders)
    expected = Splits(RULE, None, frozenset(), ())
    first = f"Splits: by the crossmodal rule over the names, as splits/ has no {name}_train.txt, _val or _test."
    return Splits(RULE, None, frozenset(n for n in mapping if expected.split(n)), (first, *notes))


def _split_places(folders: Folders, split_dir: str | None) -> list[Path]:
    """Return the folders that may hold split files, in order of preference."""
    if split_dir is None:
        return [place / "splits" for place in folders.places if (place / "splits").is_dir()]
    # Joining an absolute split_dir to a folder leaves it unchanged.
    custom = [place / Path(split_dir).expanduser() for place in reversed(folders.places)]
    existing = [place for place in custom if place.is_dir()]
    if not existing:
        raise SourceError(
            "aist++: the folder of the split files does not exist",
            where=str(custom[0]),
            allowed="a folder with NAME_train.txt, NAME_val.txt, NAME_test.txt",
            fix="correct split_dir, a folder relative to the source or an absolute path",
        )
    return existing


def _no_such_split(name: str, places: list[Path], split_dir: str | None) -> None:
    """Raise SourceError with the expected files and the available splits."""
    available = {
        path.stem.removesuffix(f"_{split}")
        for place in places
        for path in list_folder(place)
        for split in SPLITS
        if path.suffix == ".txt" and path.stem.endswith(f"_{split}")
    }
    expected = ", ".join(f"{name}_{split}.txt" for split in SPLITS)
    where = ", ".join(str(place) for place in places)
    allowed = sorted(available | ({RULE} if split_dir is None else set())) + ([ALL] if split_dir is None else [])
    raise SourceError(
        f"aist++: there is no split {name!r}; expected {expected}",
        where=where or "no folder splits/ in the source",
        found=", ".join(describe(place) for place in places) or "no split files",
        allowed=listed(allowed, 20) or "a split with files",
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
                    f"aist++: sequence {shown(sequence)} is in two splits",
                    where=f"{paths[of[sequence]]} and {paths[split]}",
                    fix="remove it from one of the files",
                )
            of[sequence] = split
        parts.append(f"{relative(paths[split], folders.source)} ({counted(len(set(names)), 'name')})")
        if len(set(names)) < len(names):
            notes.append(f"{paths[split].name} lists some names more than once; each counts once.")
    return Splits(name, of, frozenset(of), (f"Splits: {', '.join(parts)}.", *notes))


def _mapping(folders: Folders) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return all names in ``cameras/mapping.txt``, if there is one, and a note."""
    for place in folders.places:
        path = place / "cameras" / "mapping.txt"
        if path.is_file():
            names = frozenset(read_names(path))
            return names, (f"Names: {relative(path, folders.source)} lists {len(names):,} sequences.",)
    return frozenset(), ()


def find_ignored(folders: Folders, use: bool, split_dir: str | None) -> Ignored:
    """Read the first ignore list in the source, even an empty one; without one use the shipped list."""
    if not use:
        return Ignored(frozenset(), "", ("not applied, as requested",))
    custom = _split_places(folders, split_dir) if split_dir is not None else []
    usual = [folder for place in folders.places for folder in (place, place / "splits")]
    paths = [folder / IGNORE_LIST for folder in (*custom, *usual)]
    lists = [(path, frozenset(read_names(path))) for path in paths if path.is_file()]
    if not lists:
        shipped = facts().ignored
        return Ignored(shipped, "the official list (shipped)", ("the official one, as the source has none",))
    path, names = lists[0]
    where = relative(path, folders.source)
    same = ", the official one" if names == facts().ignored else ""
    notes = [f"{where}{same}"]
    others = [relative(other, folders.source) for other, its in lists[1:] if its != names]
    if others:
        notes.append(f"not used: {listed(others)}, which differ")
    return Ignored(names, where, tuple(notes))
