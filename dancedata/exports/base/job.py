"""The base class of exports, their job, and missing requirements of a dataset."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from dancedata.core.plugins import Plugin
from dancedata.core.registry import Registry
from dancedata.kernel import Progress

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip, SourceMusic, Store

T = TypeVar("T")


@dataclass(frozen=True)
class Missing:
    """Something that a dataset lacks for an export.

    Attributes
    ----------
    problem
        What is missing or has the wrong rate, width or name, with what was found.
    fix
        The line of a recipe, or the option, that gives it.
    """

    problem: str
    fix: str

    def __str__(self) -> str:
        return f"{self.problem}; {self.fix}"


@dataclass(frozen=True)
class ExportJob:
    """Request for an export.

    Attributes
    ----------
    store
        The dataset.
    out
        Absolute path that the folder of the export will have, for files that hold absolute paths.
    source
        Folder with the music; None for that which the dataset was built from, for targets that need it.
    link
        Whether files of equal bytes become hard links of one.
    fields
        Names of the fields that clips have to have, `Export.reads`; clips without one of them are left out.
    """

    store: Store
    out: Path
    source: Path | None = None
    link: bool = False
    progress: Progress = field(default_factory=lambda: Progress(quiet=True))
    fields: tuple[str, ...] = ()

    def clips(self, *splits: str) -> list[Clip]:
        """Return the clips of some splits that have `fields`, by id; of all splits if none is named."""
        chosen = splits or self.store.splits
        clips = (c for c in self.store if c.split in chosen and c.id not in self.without)
        return sorted(clips, key=lambda clip: clip.id)

    def groups(self, *splits: str) -> dict[str, list[Clip]]:
        """Return the dancers of each group of some splits, in their order, by the group's name."""
        groups: dict[str, list[Clip]] = {}
        for clip in sorted(self.clips(*splits), key=lambda clip: (clip.group, clip.member)):
            if clip.group:
                groups.setdefault(clip.group, []).append(clip)
        return groups

    @cached_property
    def without(self) -> dict[str, tuple[str, ...]]:
        """By clip that is left out, those of `fields` that it, or a dancer of its group, does not have."""
        left_out: dict[str, tuple[str, ...]] = {}
        for unit in self.store.clips().units() if self.fields else ():
            names = tuple(name for name in self.fields if not all((name in clip) for clip in unit))
            left_out |= {clip.id: names for clip in unit if names}
        return left_out

    @cached_property
    def music(self) -> SourceMusic:
        """The music below `music_folder`. UsageError without a folder, SourceError where it cannot be read."""
        from dancedata.kernel import SourceMusic

        return SourceMusic.of(self.store, self.music_folder)

    @cached_property
    def music_folder(self) -> Path | None:
        """`source`; else the folder that the dataset was built from, where it is still there."""
        return self.source or self.store.source_folder

    def each(self, label: str, items: Sequence[T]) -> Iterator[T]:
        """Return the items one by one and show the progress."""
        if not items:
            return
        with self.progress.stage(label, len(items)) as advance:
            for item in items:
                yield item
                advance(1)


def record_json(clip: Clip) -> dict[str, Any]:
    """Return the attributes of a clip as plain JSON data; group, offsets and free columns only where it has them."""
    values = {
        key: value for key, value in vars(clip.record).items() if key not in _OPTIONAL or value != _OPTIONAL[key]
    }
    del values["made_of"]
    return {
        key: list(value) if isinstance(value, tuple) else str(value) if isinstance(value, Fraction) else value
        for key, value in values.items()
    }


#: Attributes that few clips have, with their defaults.
_OPTIONAL: dict[str, Any] = {
    "group": "", "member": -1, "role": "", "song": "", "slice_of": "", "slice_start": 0,
    "source_start": None, "source_end": None, "audio_start": 0, "audio_start_by": "", "licence": -1, "columns": {},
}  # fmt: skip


def field_json(job: ExportJob, name: str, **more: Any) -> dict[str, Any]:
    """Return the description of a field as plain JSON data, with its scaler where there are train windows."""
    entry = {**job.store.field(name).to_json(), **more}
    if (
        job.store.field(name).codebook is None
        and "train" in job.store.splits
        and len(job.store.windows("train", fields=(name,)))
    ):
        scaler = job.store.scaler(name)
        entry |= {"scaler": scaler.state_dict(), "scaler_sha256": scaler.sha256}
    return entry


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
        Folders of which a loader opens every file: nothing except its own files may be written there.
    guide_text
        Markdown of `guide`, with places for ``out``, parameters by their names, and `guide_values`.
    """

    recipe: ClassVar[Mapping[str, Any]]
    reference: ClassVar[str] = ""
    listed_folders: ClassVar[tuple[str, ...]] = ()
    guide_text: ClassVar[str] = ""

    @abstractmethod
    def missing(self, job: ExportJob) -> list[Missing]:
        """Return everything that the dataset lacks for this export; nothing is written while there is something.

        `dancedata.exports.base.needs` has the usual checks: fields, rates, splits, names, music.
        """

    def reads(self, job: ExportJob) -> tuple[str, ...]:
        """Return the fields that clips have to have; those without one of them are left out, with a note.

        By default the motion fields of `recipe` that the dataset has.
        """
        return tuple(name for name in self.recipe.get("motion", ()) if name in job.store.fields)

    @abstractmethod
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        """Write the files. Called once `missing` has returned nothing.

        Parameters
        ----------
        folder
            Its methods write files by their path below the folder of the export.
        """

    def head(self, job: ExportJob) -> str:
        """Return the head of the README, such as the YAML that hubs read; by default nothing."""
        return ""

    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        """Return what fills further places of `guide_text`."""
        return {}

    def guide(self, job: ExportJob) -> str:
        """Return Markdown for the README of the export: by default `guide_text`, filled.

        The trainer's command, its caches that have to be removed, and where it is known to stop.
        """
        parameters = {f.name: getattr(self, f.name) for f in fields(self)}
        return self.guide_text.format(**parameters, **{"out": quote(str(job.out)), **self.guide_values(job)})


EXPORTS = Registry("export", "dancedata.exports", Export)
