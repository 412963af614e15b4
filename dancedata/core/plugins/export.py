"""Export: the base class of what writes the files of other programs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.plugins.plugin import Plugin

if TYPE_CHECKING:  # an export reads a whole dataset: the only plug-in that takes more than values of core
    from dancedata.exporting.folder import ExportFolder
    from dancedata.exporting.job import ExportJob, Lack


class Export(Plugin):
    """Writes a built dataset as the files that one trainer or program reads.

    Attributes
    ----------
    recipe
        Keys of a recipe whose datasets have all that the export needs, as in a recipe's YAML. Errors show them, and
        the conformance suite builds such a dataset.
    reference
        Repository and commit of the code that reads the files; "" where there is none.
    listed_folders
        Folders of which a loader opens every file: besides its own files nothing may be written there.
    """

    recipe: ClassVar[Mapping[str, Any]]
    reference: ClassVar[str] = ""
    listed_folders: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def lacks(self, job: ExportJob) -> list[Lack]:
        """Return everything that the dataset lacks for this export; nothing is written while there is something.

        `dancedata.exporting.needs` has the usual checks: fields, rates, splits, scope, names, music.
        """

    @abstractmethod
    def write(self, job: ExportJob, folder: ExportFolder) -> None:
        """Write the files. Called once `lacks` has returned nothing.

        Parameters
        ----------
        folder
            Its methods write files by their path below the folder of the export.
        """

    @abstractmethod
    def guide(self, job: ExportJob) -> str:
        """Return Markdown for the README of the export.

        The trainer's command, its caches that have to be removed, and where it is known to stop.
        """
