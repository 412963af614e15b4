"""template_name: motion as text, one file per clip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from dancedata.core.errors import UsageError
from dancedata.core.tables import csv_cell
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field
from dancedata.files.atomic_folder import AtomicFolder

_FIELD = "joints"


@EXPORTS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Export):
    """Joint positions as comma-separated values, one file per clip.

    Attributes
    ----------
    digits
        Digits after the decimal point.
    """

    version: ClassVar[int] = 1  # raise it whenever the files change
    recipe: ClassVar[Mapping[str, Any]] = {"motion": {_FIELD: {}}}
    listed_folders: ClassVar[tuple[str, ...]] = ("clips",)

    digits: int = 4

    def __post_init__(self) -> None:
        """Check the parameters."""
        if not 0 <= self.digits <= 9:
            raise UsageError("invalid number of digits", found=self.digits, allowed="0 to 9")

    def missing(self, job: ExportJob) -> list[Missing]:
        """Return the missing requirements of the dataset, with the line of a recipe that gives it."""
        return needs_field(job, _FIELD, kind="motion")

    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        """Write clips/<id>.csv."""
        header = ",".join(str(csv_cell(label)) for label in job.store.fields[_FIELD].labels)
        for clip in job.each("clips", job.clips()):
            rows = [",".join(f"{value:.{self.digits}f}" for value in row) for row in clip.read(_FIELD)]
            folder.write_text(f"clips/{clip.id}.csv", "\n".join([header, *rows]) + "\n")

    def guide(self, job: ExportJob) -> str:
        """Return how the files are used, for README.md."""
        return f"`clips/*.csv`: a row per frame, {job.store.fps} per second, metres, +Y up.\n"
