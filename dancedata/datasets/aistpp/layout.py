"""Files and lists of an AIST++ copy: its folders, music, splits and ignore list. No motion or audio file is read."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.resources import manifest
from dancedata.core.text import counted, listed, shown
from dancedata.datasets.aistpp.facts import (
    crossmodal_split,
    music_problem,
    sequence_problem,
)
from dancedata.datasets.files import ALL, SPLITS, Files, list_audio, read_names
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.listing import describe, list_folder, relative
from dancedata.formats.aist_names import SequenceName, parse_name

LAYOUT = Layout(
    dataset="aist++",
    title="AIST++",
    motions="motions",
    suffix=".pkl",
    name_problem=sequence_problem,
    # The copies of EDGE and of the project page.
    is_known=("edge_aistpp", "aist_plusplus_final").__contains__,
    looked_for="motions/*.pkl, in the source folder or in one folder below it "
    "(edge_aistpp/, aist_plusplus_final/, ...)",
    named="pickles named as gBR_sBM_cAll_d04_mBR2_ch08.pkl",
    mistakes={
        "motion": "motion/ (without s) is the layout of FineDance: build that dataset, "
        "or set --source to another folder"
    },
)
MUSIC_FOLDERS = ("wavs", "music", "audio", "musics")
#: The split that a rule over the names defines.
RULE = "crossmodal"
IGNORE_LIST = "ignore_list.txt"


@dataclass(frozen=True)
class Splits:
    """The chosen split.

    `name`: The parameter in the recipe.
    `of`: Sequence name -> split, without the sequences in none.
    `from_files`: Whether split files decide, in place of a rule over the names.
    `expected`: Names that should have a pickle, from the split files or from ``cameras/mapping.txt``.
    `notes`: The files that were read.
    """

    name: str
    of: Mapping[str, str]
    from_files: bool
    expected: frozenset[str]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Ignored:
    """Names on the ignore list, and its origin, for rejects and notes."""

    names: frozenset[str]
    where: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Copy:
    """A copy of AIST++.

    `layout`: "official", "edge" or "mixed".
    `sequences`: Parts of the name of each sequence with a motion file; sequences that are left out of the dataset
        count.
    `music`: Audio files by stem: a sequence name or a music id.
    `recordings`, `songs`: Stems of the audio files in use: those of one sequence, and those of a song.
    `rejects`: Audio files that no sequence uses, and entries that are not read.
    """

    folders: Folders
    layout: str
    motions: Files
    sequences: Mapping[str, SequenceName]
    music: Files
    recordings: frozenset[str]
    songs: frozenset[str]
    splits: Splits
    ignored: Ignored
    rejects: tuple[Reject, ...]


def find_copy(source: Path, split: str, split_dir: str | None, ignore: bool, music_dir: Path | None = None) -> Copy:
    """List the files of a copy and read its lists.

    Raises SourceError: if the folder is not an AIST++ copy, or its lists are unusable.
    """
    folders, motions = LAYOUT.list_motions(source)
    music_folders = [place / name for place in folders.places for name in MUSIC_FOLDERS]
    music_folders = [folder for folder in (*music_folders, *folders.places) if folder.is_dir()]
    music = list_audio(music_folders, source, music_problem, mixed=folders.places, music_dir=music_dir)
    sequences = {name: parts for name in motions.files if (parts := parse_name(name)) is not None}
    recordings = frozenset(name for name in sequences if name in music.files)
    songs = {
        parts.music for name, parts in sequences.items() if name not in recordings and parts.music in music.files
    }
    unused = _unused_music(source, music, sequences, recordings | songs)
    return Copy(
        folders,
        "mixed" if recordings and songs else "edge" if recordings else "official",
        motions,
        sequences,
        music,
        recordings,
        frozenset(songs),
        _find_splits(folders, sequences, split, split_dir),
        _find_ignored(folders, ignore, split_dir),
        (*unused, *music.rejects, *motions.rejects),
    )


def _unused_music(
    source: Path, music: Files, sequences: Mapping[str, SequenceName], used: frozenset[str]
) -> list[Reject]:
    danced = {parts.music for parts in sequences.values()}
    rejects = []
    for stem, path in music.files.items():
        if stem in used:
            continue
        if parse_name(stem):
            detail = f"there is no motions/{stem}.pkl"
        elif stem in danced:
            detail = "every sequence danced to it has its own audio file"
        else:
            detail = "no motion in the source is danced to it"
        rejects.append(Reject("unused_music", file=relative(path, source), detail=detail))
    return rejects


def _find_splits(folders: Folders, sequences: Mapping[str, SequenceName], name: str, split_dir: str | None) -> Splits:
    """Read the split files if there are any, else use the rule over the names."""
    if name == ALL:
        mapping, notes = _mapping(folders)
        text = "Splits: none requested; every clip is in the split 'all'."
        return Splits(ALL, dict.fromkeys(sequences, ALL), False, mapping, (text, *notes))
    places = _split_places(folders, split_dir)
    for place in places:
        paths = {split: place / f"{name}_{split}.txt" for split in SPLITS}
        existing = {split: path for split, path in paths.items() if path.is_file()}
        if existing:
            return _from_files(folders, name, existing)
    if name != RULE or split_dir is not None:
        _no_such_split(name, places, split_dir)
    mapping, notes = _mapping(folders)
    parsed = {n: parts for n in mapping if (parts := parse_name(n)) is not None} | dict(sequences)
    of = {n: split for n, parts in parsed.items() if (split := crossmodal_split(parts))}
    first = f"Splits: by the crossmodal rule over the names, as splits/ has no {name}_train.txt, _val or _test."
    return Splits(RULE, of, False, mapping & set(of), (first, *notes))


def _split_places(folders: Folders, split_dir: str | None) -> list[Path]:
    """Return the folders that may hold split files, in order of preference."""
    if split_dir is None:
        return [place / "splits" for place in folders.places if (place / "splits").is_dir()]
    # Joining an absolute split_dir to a folder leaves it unchanged.
    custom = [place / Path(split_dir).expanduser() for place in reversed(folders.places)]
    existing = [place for place in custom if place.is_dir()]
    if not existing:
        raise SourceError("aist++: the folder of the split files does not exist", where=str(custom[0]),
                          allowed="a folder with NAME_train.txt, NAME_val.txt, NAME_test.txt",
                          fix="correct split_dir, a folder relative to the source or an absolute path")  # fmt: skip
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
    raise SourceError(f"aist++: there is no split {name!r}; expected {expected}",
                      where=where or "no folder splits/ in the source",
                      found=", ".join(describe(place) for place in places) or "no split files",
                      allowed=listed(allowed, 20) or "a split with files",
                      fix="correct split in the recipe, or split_dir")  # fmt: skip


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
                raise SourceError(f"aist++: sequence {shown(sequence)} is in two splits",
                                  where=f"{paths[of[sequence]]} and {paths[split]}",
                                  fix="remove it from one of the files")  # fmt: skip
            of[sequence] = split
        parts.append(f"{relative(paths[split], folders.source)} ({counted(len(set(names)), 'name')})")
        if len(set(names)) < len(names):
            notes.append(f"{paths[split].name} lists some names more than once; each counts once.")
    return Splits(name, of, True, frozenset(of), (f"Splits: {', '.join(parts)}.", *notes))


def _mapping(folders: Folders) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return all names in ``cameras/mapping.txt``, if there is one, and a note."""
    for place in folders.places:
        path = place / "cameras" / "mapping.txt"
        if path.is_file():
            names = frozenset(read_names(path))
            return names, (f"Names: {relative(path, folders.source)} lists {len(names):,} sequences.",)
    return frozenset(), ()


def _find_ignored(folders: Folders, use: bool, split_dir: str | None) -> Ignored:
    """Read the first ignore list in the source, even an empty one; without one use the shipped list."""
    if not use:
        return Ignored(frozenset(), "", ("not applied, as requested",))
    custom = _split_places(folders, split_dir) if split_dir is not None else []
    usual = [folder for place in folders.places for folder in (place, place / "splits")]
    paths = [folder / IGNORE_LIST for folder in (*custom, *usual)]
    lists = [(path, frozenset(read_names(path))) for path in paths if path.is_file()]
    if not lists:
        shipped = frozenset(manifest("aistpp")["ignored"])
        return Ignored(shipped, "the official list (shipped)", ("the official one, as the source has none",))
    path, names = lists[0]
    where = relative(path, folders.source)
    same = ", the official one" if names == frozenset(manifest("aistpp")["ignored"]) else ""
    notes = [f"{where}{same}"]
    others = [relative(other, folders.source) for other, its in lists[1:] if its != names]
    if others:
        notes.append(f"not used: {listed(others)}, which differ")
    return Ignored(names, where, tuple(notes))
