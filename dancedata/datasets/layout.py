"""The folders of a published dataset: where its motion folder is, and which of its entries are motions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.errors import SourceError
from dancedata.core.text import listed
from dancedata.datasets.files import Files, files_by_stem, require_folder
from dancedata.files.listing import describe, list_folder

_ARCHIVES = (".zip", ".tgz", ".gz", ".tar", ".rar", ".7z")


@dataclass(frozen=True)
class Folders:
    """The source, and the folder with the motion folder: the source or one folder in it.

    `places`: Folders that may hold lists and music folders, in order of preference.
    `others`: Further folders with a motion folder, which are not read.
    """

    source: Path
    root: Path
    places: tuple[Path, ...]
    others: tuple[Path, ...]


@dataclass(frozen=True)
class Layout:
    """Names of the folders and motion files of a published dataset.

    `dataset`, `title`: Name of the dataset for recipes, and its published name.
    `motions`, `suffix`: Name of the motion folder, and suffix of its files.
    `name_problem`: Returns why a stem is not a valid name, "" for a valid one.
    `is_known`: Accepts the folder names under which the dataset is published; decides between several folders.
    `looked_for`, `named`: The expected files and their names, for messages.
    `mistakes`: Entry of the source -> fix, for folders of other datasets and of features.
    """

    dataset: str
    title: str
    motions: str
    suffix: str
    name_problem: Callable[[str], str]
    is_known: Callable[[str], bool]
    looked_for: str
    named: str
    mistakes: Mapping[str, str]

    def find(self, source: Path) -> Folders:
        """Find the folder that holds the motion folder: the source or one folder directly below it.

        Raises SourceError: if the folder does not exist, or there are several candidates; names the expected and the
            existing files.
        """
        require_folder(self.dataset, source, self.looked_for)
        if (source / self.motions).is_dir():
            return Folders(source, source, (source,), ())
        below = [entry for entry in list_folder(source) if (entry / self.motions).is_dir()]
        chosen = below if len(below) == 1 else [entry for entry in below if self.is_known(entry.name)]
        if len(chosen) == 1:
            (root,) = chosen
            return Folders(source, root, (root, source), tuple(entry for entry in below if entry != root))
        if below:
            raise SourceError(f"{self.dataset}: several folders could be the dataset", where=str(source),
                              found=listed(f"{entry.name}/{self.motions}/" for entry in below),
                              fix="set --source to one of them")  # fmt: skip
        raise SourceError(f"{self.dataset}: no {self.title} motion found", where=str(source), found=describe(source),
                          allowed=self.looked_for, fix=self._advice(list_folder(source)))  # fmt: skip

    def _advice(self, entries: list[Path]) -> str:
        """Return the fix for the most likely mistake, for a source without the motion folder."""
        if any(entry.suffix.lower() == self.suffix for entry in entries):
            return f"this looks like the {self.motions} folder itself: set --source to its parent folder"
        names = {entry.name for entry in entries}
        for name, fix in self.mistakes.items():
            if name in names:
                return fix
        if any(entry.suffix.lower() in _ARCHIVES for entry in entries):
            return "unpack the archive first"
        return f"set --source to the folder that contains {self.motions}/"

    def list_motions(self, source: Path) -> tuple[Folders, Files]:
        """Find the motion folder and list its files with valid names; every other entry is an ``extra_file``.

        Raises SourceError: As `find`, or if there are none.
        """
        folders = self.find(source)
        folder = folders.root / self.motions
        files = files_by_stem(folder, folders.source, self.suffix, self.name_problem)
        if not files.files:
            raise SourceError(f"{self.dataset}: the motion folder contains no {self.title} sequence",
                              where=str(folder), found=describe(folder), allowed=self.named,
                              fix="check that the archive was unpacked completely")  # fmt: skip
        return folders, files
