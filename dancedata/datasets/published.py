"""The base of readers of published datasets: layout, lists, music, what is left out, and notes, from declarations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args, get_type_hints

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DataError, SourceError
from dancedata.core.plugins import Dataset
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.files import (
    ALL,
    NO_FILES,
    SPLITS,
    Files,
    clips_note,
    describe,
    files_by_stem,
    list_audio,
    read_lists,
    relative,
    require_choices,
    require_folder,
)

OFFICIAL = "official"
_ARCHIVES = (".zip", ".tgz", ".gz", ".tar", ".rar", ".7z")


class LeftOut(Exception):  # noqa: N818 - no error: it says what a scan does with a file
    """Why a motion makes no clip: raised by hooks of `PublishedDataset`, which makes a reject of it."""

    def __init__(self, reason: str, detail: str, *, music: str = "", fix: str = "") -> None:
        super().__init__(detail)
        self.reason, self.music, self.fix = reason, music, fix


@dataclass(frozen=True)
class Folders:
    """The source, the folder in it with the motions, `places` of lists and music, and `others`, not read."""

    source: Path
    root: Path
    places: tuple[Path, ...]
    others: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Layout:
    """Names of the folders and motion files of a published dataset.

    `dataset`, `title`: Name of the dataset for recipes, and its published name.
    `motions`, `suffix`: Name of the motion folder, and suffix of its files.
    `named`: The expected names of files, for messages.
    `name_problem`: Returns why a stem is not a valid name, "" for a valid one.
    `folder_names`: Parts of the names under which the dataset is published, in lower case: of several folders with
        motion the one that has one is read.
    `stem`, `music`: Names of motion and music files without suffix; {} is the name of the sequence: "{}_smpl".
    `published`: How many were published, for the note: "1,624 were published".
    """

    dataset: str
    title: str
    motions: str
    suffix: str
    named: str
    name_problem: Callable[[str], str] = lambda stem: ""
    folder_names: tuple[str, ...] = ()
    stem: str = "{}"
    music: str = "{}"
    published: str = ""

    @property
    def expected(self) -> str:
        """The expected files, for messages."""
        return f"{self.motions}/{self.named}, in the source folder or in one folder below it"

    def path_of(self, name: str) -> str:
        """Return the path of a motion file in the dataset's folder."""
        return f"{self.motions}/{self.stem.format(name)}{self.suffix}".lstrip("/")

    def find(self, source: Path) -> Folders:
        """Return the folder that holds the motion folder, the source or one in it; SourceError for several."""
        entries = require_folder(self.dataset, source, self.expected)
        if (source / self.motions).is_dir():
            return Folders(source, source, (source,))
        below = [entry for entry in entries if (entry / self.motions).is_dir()]
        known = [entry for entry in below if any(name in entry.name.lower() for name in self.folder_names)]
        chosen = below if len(below) == 1 else known
        if len(chosen) == 1:
            (root,) = chosen
            return Folders(source, root, (root, source), tuple(entry for entry in below if entry != root))
        if below:
            raise SourceError(f"{self.dataset}: several folders could be the dataset", where=str(source),
                              found=listed(f"{entry.name}/{self.motions}/" for entry in below),
                              fix="set SOURCE to one of them")  # fmt: skip
        raise SourceError(f"{self.dataset}: no {self.title} motion found", where=str(source), found=describe(source),
                          allowed=self.expected, fix=self._advice(entries))  # fmt: skip

    def list_music(self, folders: Folders, names: Sequence[str], music_dir: Path | None) -> Files:
        """List the music in folders of these names, beside the motion folder, by the name of the sequence."""
        places = [place / name for place in folders.places for name in names]
        files = list_audio(places, folders.source, lambda stem: self._problem(stem, self.music), music_dir=music_dir)
        return replace(files, files={_name(stem, self.music): path for stem, path in files.files.items()})

    def _problem(self, stem: str, form: str) -> str:
        name = _name(stem, form)
        return self.name_problem(name) if name else f"not named {form.format('NAME')}"

    def _advice(self, entries: list[Path]) -> str:
        if any(entry.suffix.lower() == self.suffix for entry in entries):
            return f"this looks like the {self.motions} folder itself: set SOURCE to its parent folder"
        if any(entry.suffix.lower() in _ARCHIVES for entry in entries):
            return "unpack the archive first"
        return f"set SOURCE to the folder that contains {self.motions}/"

    def list_motions(self, source: Path) -> tuple[Folders, Files]:
        """Return the folders and the motion files by name; others are ``extra_file``. SourceError without any."""
        folders = self.find(source)
        folder = folders.root / self.motions
        files = files_by_stem(folder, folders.source, self.suffix, lambda stem: self._problem(stem, self.stem))
        files = replace(files, files={_name(stem, self.stem): path for stem, path in files.files.items()})
        if not files.files:
            raise SourceError(f"{self.dataset}: the motion folder contains no {self.title} sequence",
                              where=str(folder), found=describe(folder), allowed=f"files named as {self.named}",
                              fix="check that the archive was unpacked completely")  # fmt: skip
        return folders, files


@dataclass(frozen=True)
class Labels:
    """Labels by the name of a motion, what of them cannot be used, and notes."""

    of: Mapping[str, Any]
    rejects: tuple[Reject, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Listing:
    """Folders of a source, its motion and music files by the name of the sequence.

    `beside`: Further files: of each dancer, where a motion is a group of files; labels.
    `layout`: Name of the layout, where the dataset has several.
    `labels`: What the source states of its motions beside them.
    """

    folders: Folders
    motions: Files
    music: Files
    beside: Files = NO_FILES
    layout: str = ""
    labels: Labels = Labels({})

    def relative(self, path: Path) -> str:
        """Return a path below the source, for messages."""
        return relative(path, self.folders.source)

    def file(self, name: str) -> str:
        """Return the path of a motion file below the source."""
        return self.relative(self.motions.files[name])


@dataclass(frozen=True)
class Splits:
    """The split of each name.

    `of`: Split by name; a name without one is ``unassigned``.
    `notes`: What decides, and what the splits share.
    `lists`: Names by list: lists of the dataset, the split's first.
    `expected`: Names that should have a motion file.
    `without`: Why a name has no split.
    `ignored`: Names that are left out whatever their split, each with the reason.
    """

    of: Mapping[str, str]
    notes: tuple[str, ...] = ()
    lists: Mapping[str, Iterable[str]] = field(default_factory=dict)
    expected: frozenset[str] = frozenset()
    without: str = "on no list of a split"
    ignored: Mapping[str, str] = field(default_factory=dict)


class PublishedDataset(Dataset):
    """Base of published datasets: a folder of motions, folders of music by their names, lists of names.

    A reader declares its layout and lists; `clips_of` and `load` say what one motion file is. It is a dataclass with
    the parameter ``split``, if it has one. Splits are ``official``: those of its lists; ``by-UNIT``: a tenth of the
    units each is val and test, by a hash of their names; ``all``: none.

    Attributes
    ----------
    layout
        The motion folder.
    music_folders
        Folders of the music beside the motion folder, in order of preference.
    unit
        What a split keeps together, as `unit_of` names it: "video", "song"; "" for nothing.
    official, recorded
        File of each official list, by split; files of further lists.
    below
        Folders below the dataset's in which the lists are looked for.
    get_lists
        Where the lists are to be had.
    body
        The body of all motions, if they share one.
    """

    layout: ClassVar[Layout]
    music_folders: ClassVar[tuple[str, ...]] = ()
    unit: ClassVar[str] = ""
    official: ClassVar[Mapping[str, str]] = {}
    recorded: ClassVar[Mapping[str, str]] = {}
    below: ClassVar[tuple[str, ...]] = ("",)
    get_lists: ClassVar[str] = "copy the lists of the dataset into the source"
    body: ClassVar[Skeleton | None] = None

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return bool(self._parameter("split", OFFICIAL) == OFFICIAL)

    # What a reader says of its files.

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return self.body

    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        """Return the clips of a motion file, by default the given one, with its song and split; or LeftOut."""
        return (ref,)

    def song_of(self, name: str) -> str:
        """Return the song of a motion by its name: by default the name."""
        return name

    def unit_of(self, name: str) -> str:
        """Return what splits keep together, by the name of a motion: by default its song."""
        return self.song_of(name)

    def listed_name(self, line: str) -> str:
        """Return the name of a motion by a line of a list: its first word, as further columns may follow."""
        return line.split(maxsplit=1)[0].split(",")[0]

    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        """Return the clips of all motion files, and add what is left out: by default `clips_of` each."""
        clips: list[ClipRef] = []
        for ref in refs:
            with rejected(left_out, ref.id, listing):
                clips += self.clips_of(ref, listing)
        return clips

    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        """Return notes of the dataset."""
        return ()

    # What the base makes of it.

    def find(self, source: Path) -> Listing:
        """List the motion and music files of a source."""
        folders, motions = self.layout.list_motions(source)
        music = self.layout.list_music(folders, self.music_folders, self._parameter("music_dir", None))
        return Listing(folders, motions, music)

    def splits(self, listing: Listing) -> Splits:
        """Return the split of each motion; SourceError if an official list is missing, or two share motions."""
        split, names = self._parameter("split", OFFICIAL), listing.motions.files
        if split == ALL:
            return Splits(dict.fromkeys(names, ALL), ("Splits: none.",))
        lists, where = read_lists(
            listing.folders.root, listing.folders.places, self.official, self.recorded, self.below, self.listed_name
        )
        official = {name: lists[name] for name in self.official if name in lists}
        expected = frozenset(name for of_split in official.values() for name in of_split)
        leak = self._leaks(official)
        if split != OFFICIAL:
            from dancedata.datasets._split_rule import TENTHS

            rule = f"a tenth of the {_plural(self.unit or 'song')} each is val and test, by a hash of their names"
            notes = (f"Splits: {split}: {rule}.",
                     *([f"Leak of the official lists, which are not used: {leak}."] if leak else []))  # fmt: skip
            return Splits({name: TENTHS.split(self.unit_of(name)) for name in names}, notes, lists, expected)
        self._require(lists, where)
        sizes = ", ".join(f"{len(of):,} {name}" for name, of in lists.items())
        hashed = self._hashed()
        keeps = f"; split: {hashed} keeps {_plural(self.unit)} together" if hashed else ""
        notes = (f"Splits: official: {sizes}{'' if 'val' in official else '; no val'}.",
                 *([f"Leak: {leak}{keeps}."] if leak else []))  # fmt: skip
        of = {name: of_split for of_split, listed_names in official.items() for name in listed_names}
        without = "on none of the official lists" + (hashed and f"; split: {hashed} assigns every motion")
        return Splits(of, notes, lists, expected, without)

    def audio_of(self, name: str, listing: Listing) -> Path | None:
        """Return the music of a motion, if there is any."""
        return listing.music.files.get(name)

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads lists of names and sizes, but neither motion nor music.

        Rejects are ``unassigned``, ``missing_music``, ``missing_motion`` (listed, but no file), the reasons of a file
        that cannot be used, ``unused_music``, ``extra_file``.
        """
        listing = self.find(Path(source))
        splits = self.splits(listing)
        refs: list[ClipRef] = []
        left_out: list[Reject] = []
        for name, path in sorted(listing.motions.files.items()):
            with rejected(left_out, name, listing):
                if name in splits.ignored:
                    raise LeftOut("ignored", splits.ignored[name])
                if name not in splits.of:
                    raise LeftOut("unassigned", splits.without)
                audio = self.audio_of(name, listing)
                keys = ((self.unit, self.unit_of(name)),) if self.unit else ()
                of, lists = splits.of[name], tuple(kind for kind, names in splits.lists.items() if name in names)
                refs.append(ClipRef(name, path, audio, of, self.song_of(name), lists=lists, keys=keys))
        clips = sorted(self.all_clips(refs, listing, left_out), key=lambda clip: clip.id)
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no {self.layout.path_of(name)}")
            for name in sorted(splits.expected - listing.motions.files.keys() - splits.ignored.keys())
        ]
        unused = [
            Reject("unused_music", file=listing.relative(path), detail=why)
            for name, path in listing.music.files.items()
            if (why := self.why_unused(name, listing))
        ]
        counted_splits = (ALL,) if set(splits.of.values()) == {ALL} else SPLITS
        notes = (*self.layout_notes(listing), *listing.music.notes, *splits.notes, *self.notes(listing, clips),
                 clips_note(clips, left_out, counted_splits))  # fmt: skip
        parts = (listing.labels, listing.music, listing.motions, listing.beside)
        further = [reject for part in parts for reject in part.rejects]
        return Scan(listing.layout or self.name, tuple(clips), (*left_out, *missing, *unused, *further), notes)

    def why_unused(self, name: str, listing: Listing) -> str:
        """Return why no motion has the music of this name, "" if one has."""
        return "" if name in listing.motions.files else f"there is no {self.layout.path_of(name)}"

    def layout_notes(self, listing: Listing) -> Iterable[str]:
        """Return the files by which the layout was recognised, with their numbers, and what is not read."""
        at, n = listing.relative(listing.folders.root / self.layout.motions), len(listing.motions.files)
        there = f"; {self.layout.published}" if self.layout.published else ""
        music = f"; {counted(len(listing.music.files), 'audio file')}" if self.has_audio else ""
        yield f"Layout: {self.layout.title}, by {at}/*{self.layout.suffix} ({counted(n, 'file')}{there}){music}."
        if listing.folders.others:
            others = listed(f"{folder.name}/" for folder in listing.folders.others)
            yield f"Not read: {others}, which also contain {self.layout.motions}/."

    def _parameter(self, parameter: str, otherwise: Any) -> Any:
        """Return the value of a parameter that not every reader has."""
        return getattr(self, parameter, otherwise)

    def _hashed(self) -> str:
        """Return the value of ``split`` that hashes names, "" where the reader has none."""
        allowed = get_args(get_type_hints(type(self)).get("split", ""))
        return next((value for value in allowed if value.startswith("by-")), "")

    def _leaks(self, official: Mapping[str, Collection[str]]) -> str:
        """Return the units that splits share, "" without any."""
        leaks, units = [], {split: {self.unit_of(name) for name in of} for split, of in official.items()}
        for earlier, split in combinations(official, 2) if self.unit else ():
            shared = units[earlier] & units[split]
            n, which = sum(self.unit_of(name) in shared for name in official[split]), listed(sorted(shared), 3)
            of = f"{n:,} of {len(official[split]):,} {split} are of {_plural(self.unit)} of {earlier} ({which})"
            leaks += [of] if shared else []
        return "; ".join(leaks)

    def _require(self, lists: Mapping[str, Collection[str]], where: Path) -> None:
        """Raise SourceError if an official list is missing, or two name the same motions."""
        missing = [f"no {file}" for split, file in self.official.items() if split not in lists]
        counts = Counter(name for split in self.official for name in lists.get(split, ()))
        both = [f"{name} ({' and '.join(split for split in self.official if name in lists[split])})"
                for name in sorted(counts) if counts[name] > 1 and not missing]  # fmt: skip
        if missing or both:
            what = "official lists are missing" if missing else "the official lists name the same motions"
            hashed = self._hashed()
            raise SourceError(f"{self.name}: {what}", where=str(where), found=listed(missing or both, 5),
                              allowed=listed(self.official.values()),
                              fix=self.get_lists + (hashed and f", or set split: {hashed}"))  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PairedDataset(PublishedDataset):
    """Base of published datasets whose motions have music, which may lie elsewhere.

    Attributes
    ----------
    music
        ``required`` leaves out motions without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    @override
    def audio_of(self, name: str, listing: Listing) -> Path | None:
        """Return the music of a motion; LeftOut if it is missing and required."""
        path = super().audio_of(name, listing)
        if path is None and self.music == "required":
            where = f"{self.music_folders[0]}/" if self.music_folders else ""
            detail = f"no {where}{self.layout.music.format(name)} as wav, flac, mp3 or ogg"
            raise LeftOut("missing_music", detail, music=self.song_of(name))
        return path


@contextmanager
def rejected(rejects: list[Reject], name: str, listing: Listing) -> Iterator[None]:
    """Add a reject for what is left out within the context."""
    try:
        yield
    except LeftOut as why:
        rejects.append(
            Reject(why.reason, clip=name, file=listing.file(name), detail=str(why), music=why.music, fix=why.fix)
        )
    except DataError as error:
        rejects.append(Reject(error.reason, clip=name, file=listing.file(name), detail=str(error)))


def _name(stem: str, form: str) -> str:
    """Return the name of the sequence in a stem, "" if it has another form."""
    before, _, behind = form.partition("{}")
    named = stem.startswith(before) and stem.endswith(behind) and len(stem) > len(before + behind)
    return stem[len(before) : len(stem) - len(behind)] if named else ""


def _plural(noun: str) -> str:
    return f"{noun.removesuffix('y')}ies" if noun.endswith("y") else f"{noun}s"
