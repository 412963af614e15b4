"""export from Python: what the command line does, which calls the same function."""

from pathlib import Path
from typing import Any

from dancedata.execution.progress import Progress
from dancedata.exports.base.job import EXPORTS
from dancedata.exports.base.run import ExportResult, export_dataset
from dancedata.recipes.plugins import make_named


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
        Folder with the music that the dataset was built from; targets that write sound need it.
    link
        Make hard links in place of files with equal bytes.
    overwrite
        Replace an export in `out` whose files were not changed.
    progress
        As in `build`.
    parameters
        The target's own, such as ``feature="jukebox"`` or ``scaler="train"``; `dancedata list` shows them.

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
        Path(store).expanduser(),
        target,
        Path(out).expanduser(),
        source=None if source is None else Path(source).expanduser(),
        link=link,
        overwrite=overwrite,
        progress=Progress(quiet=not progress),
    )
