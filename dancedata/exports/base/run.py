"""Export of a dataset: checks, the target's files, README, licence and export.json."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import dataset_hashes
from dancedata.core.terms import clips_by_terms, terms_text
from dancedata.core.text import counted, listed, quoted, shown, size_text
from dancedata.core.version import __version__
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.files.addresses import local_folder
from dancedata.files.atomic_folder import README, AtomicFolder, atomic_folder, read_about
from dancedata.files.documents import document_of
from dancedata.kernel import Progress, Store, is_source, make_named, open_store

_TEXT = 5000


def _readme_text(target: Export, job: ExportJob, notes: Sequence[str]) -> str:
    name = shown(job.store.info.get("name", job.store.path.name))
    reads = f" Files as `{target.reference}` reads them." if target.reference else ""
    listed = ", ".join(f"`{folder}/`" for folder in target.listed_folders)
    parts = [
        *filter(None, [target.head(job)]),
        f"# {name}, exported as {target.name}\n",
        f"Written by `dancedata export --to {target.name}`.{reads} `export.json` has the parameters, the hash of the "
        f"dataset, and every file with its size and SHA-256.\n",
        target.guide(job).strip() + "\n",
    ]
    if listed:
        parts.append(f"The loader opens every file in {listed}: put nothing else there.\n")
    if notes:
        parts.append("## What to know\n\n" + "\n".join(f"- {shown(note, _TEXT)}" for note in notes) + "\n")
    parts.append(_origin(job.store))
    return "\n".join(parts)


def _licence_text(store: Store) -> str:
    licence, citation = (shown(store.info.get(key) or "", _TEXT) for key in ("licence", "citation"))
    if not licence:
        return ""
    return (
        f"These files were made from a dataset with this licence; it holds for them too:\n\n{licence}\n\n"
        f"Cite: {citation or 'see the dataset'}\n{_terms(store)}"
    )


def _origin(store: Store) -> str:
    licence, citation = (shown(store.info.get(key) or "unknown", _TEXT) for key in ("licence", "citation"))
    return f"## Origin\n\nLicence of the data: {licence}\n\nCite: {citation}\n{_terms(store)}"


def _terms(store: Store) -> str:
    lines = "".join(f"- {shown(line, _TEXT)}\n" for line in terms_text(clips_by_terms(store)))
    return f"\nClips have terms of their own:\n\n{lines}" if lines else ""


LICENCE = "LICENCE.txt"
#: Longest id of a clip, in bytes: file names end with more.
_MAX_NAME = 200


@dataclass(frozen=True)
class ExportResult:
    """A finished export: the absolute path of its folder, and what its export.json holds."""

    path: Path
    about: Mapping[str, Any]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on these files."""
        return tuple(self.about["notes"])

    @property
    def summary(self) -> str:
        """Files written, with notes."""
        files = self.about["files"]
        size = size_text(sum(size for size, _ in files.values()))
        head = f"exported {shown(self.about['name'])} as {self.about['target']} to {shown(self.path)}"
        lines = [f"{head}: {counted(len(files), 'file')}, {size}"]
        lines += [f"  {shown(note, 2000)}" for note in self.notes]
        return "\n".join([*lines, f"read {shown(self.path / README)}: how to use the files"])

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data, without the list of files."""
        files = self.about["files"]
        record = {key: value for key, value in self.about.items() if key not in ("files", "self_sha256")}
        return {
            "path": str(self.path),
            **record,
            "files": len(files),
            "bytes": sum(size for size, _ in files.values()),
        }


def export(
    store: str | Path,
    to: str,
    out: str | Path,
    *,
    source: str | Path | None = None,
    link: bool = False,
    overwrite: bool = False,
    progress: bool = True,
    **parameters: Any,
) -> ExportResult:
    """Write a built dataset as the files that another trainer or program reads, as ``dancedata export`` does.

    Parameters
    ----------
    store
        Folder that `build` wrote.
    to
        Name of the target: "edge", "lodge", "npz", ...
    out
        Folder to write: a new or empty one. It appears when all is written.
    source
        Folder with the music, of which some targets write sound; by default that which the dataset was built from.
    link
        Make hard links in place of files with equal bytes.
    overwrite
        Replace an export in `out` whose files were not changed.
    progress
        As in `build`.
    parameters
        The target's own, such as ``feature="jukebox"`` or ``scaler="train"``; `dancedata info TARGET` shows them.

    Returns
    -------
    ExportResult
        Path, notes, and `about`: what its export.json holds.

    Raises
    ------
    UsageError
        For an unknown target, or as RecipeError for parameters that it does not take.
    StoreError
        With everything that the dataset lacks for the target and the lines of a recipe that give it; if `out` holds
        other files, or cannot be written.
    DataError
        If music below `source` cannot be decoded, or does not match the dataset.

    Examples
    --------
    >>> import dancedata
    >>> dancedata.export("data/aistpp", "edge", "exports/edge", source="~/aist_plusplus_final").notes
    ('the split val (1 clip) is not exported: --set val_as_test=true adds it to test', ...)
    """
    target = make_named(EXPORTS, "export", to, parameters)
    return export_dataset(
        local_folder(store),
        target,
        Path(out).expanduser(),
        source=None if source is None else Path(source).expanduser(),
        link=link,
        overwrite=overwrite,
        progress=Progress(quiet=not progress),
    )


def export_dataset(
    path: Path,
    target: Export,
    out: Path,
    *,
    source: Path | None = None,
    link: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ExportResult:
    """Export a dataset; see `dancedata.export`."""
    with open_store(path) as store:
        job = ExportJob(store, Path(os.path.abspath(out)), source, link, progress or Progress(quiet=True))
        _check_place(job)
        job = replace(job, fields=tuple(name for name in target.reads(job) if name in store.optional_fields))
        _require_complete(target, job, _needs_file_names(job) + target.missing(job))
        store.require_intact()
        with atomic_folder(job.out, overwrite=overwrite, link=link) as folder:
            target.write(job, folder)
            _finish(target, job, folder)
    record = read_about(job.out)
    if record is None:
        raise StoreError("the export was changed while it was written", where=job.out)
    return ExportResult(job.out, record)


def _require_complete(target: Export, job: ExportJob, missing: list[Missing]) -> None:
    if not missing:
        return
    lines = "".join(f"\n- {entry.problem}\n  fix: {entry.fix}" for entry in missing)
    raise StoreError(
        f"the dataset cannot be exported as {target.name}; nothing was written:{lines}", where=job.store.path
    )


def _needs_file_names(job: ExportJob) -> list[Missing]:
    bad = [quoted(c.id) for c in job.clips() if "/" in c.id or c.id.startswith(".") or len(c.id.encode()) > _MAX_NAME]
    if not bad:
        return []
    return [Missing(f"ids of clips that cannot be names of files: {listed(bad)}", "rename the source files")]


def _check_place(job: ExportJob) -> None:
    if job.out.resolve() == Path.cwd():
        raise UsageError(
            "cannot replace the current working directory", where=job.out, fix="export from another folder"
        )
    for kind, folder in (("dataset", job.store.path), ("source", job.source)):
        if folder is not None and job.out.resolve().is_relative_to(folder.resolve()):
            raise UsageError(
                f"an export cannot be written into its {kind}", where=job.out, fix="choose another --out"
            )
    for folder in (job.out.resolve(), *job.out.resolve().parents):
        if is_source(job.store, folder):
            raise UsageError("an export cannot be written into its source", where=job.out,
                             found=f"motion files of the dataset in {folder}",
                             fix="choose another --out")  # fmt: skip


def _finish(target: Export, job: ExportJob, folder: AtomicFolder) -> None:
    if job.without:
        lacking = listed(sorted({name for names in job.without.values() for name in names}))
        folder.note(
            f"{counted(len(job.without), 'clip')} kept without {lacking}, or of a group with one, are not exported: "
            f"{listed(sorted(job.without))}"
        )
    if folder.linked:
        folder.note(
            f"{counted(folder.linked, 'file')} are hard links of files with equal bytes, of this export or of the "
            "source: a change of one changes the other"
        )
    licence = _licence_text(job.store)
    if licence:
        folder.write_text(LICENCE, licence)
    folder.write_text(README, _readme_text(target, job, folder.notes))
    record = {
        "dancedata": __version__,
        "target": target.name,
        "version": target.version,
        "parameters": document_of(target),
        "reference": target.reference,
        "name": str(job.store.info.get("name", job.store.path.name)),
        "dataset": {"self_sha256": None, "recipe_sha256": None, **dataset_hashes(job.store.info)},
        **({} if job.store.origin is None else {"address": job.store.origin.address}),
        "clips": {split: len(job.clips(split)) for split in job.store.splits},
        "licence": job.store.info.get("licence"),
        **({"licences": job.store.info["licences"]} if job.store.licences else {}),
        "notes": list(folder.notes),
    }
    folder.finish(record)
