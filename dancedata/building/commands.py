"""build from Python; the command line calls the same function."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

from dancedata.building.arguments import BuildArguments, RecipeLike, jobs_of
from dancedata.building.build import BuildResult
from dancedata.building.build import build as _build
from dancedata.core.arguments import Overrides, folder_of
from dancedata.execution.progress import Progress

if TYPE_CHECKING:
    from dancedata.building.plan import Plan


@overload
def build(
    recipe: RecipeLike, source: str | Path | None = ..., out: str | Path | None = ..., *,
    dry_run: Literal[False] = ..., overrides: Overrides = ..., jobs: int | None = ..., overwrite: bool = ...,
    strict: bool = ..., cache: str | Path | None = ..., backend: str | None = ..., scheduler: str | None = ...,
    progress: bool = ...,
) -> BuildResult: ...  # fmt: skip


@overload
def build(
    recipe: RecipeLike, source: str | Path | None = ..., out: str | Path | None = ..., *, dry_run: Literal[True],
    overrides: Overrides = ..., jobs: int | None = ..., cache: str | Path | None = ..., progress: bool = ...,
) -> Plan: ...  # fmt: skip


def build(
    recipe: RecipeLike,
    source: str | Path | None = None,
    out: str | Path | None = None,
    *,
    dry_run: bool = False,
    overrides: Overrides = (),
    jobs: int | None = None,
    overwrite: bool = False,
    strict: bool = False,
    cache: str | Path | None = None,
    backend: str | None = None,
    scheduler: str | None = None,
    progress: bool = True,
) -> BuildResult | Plan:
    """Build a dataset, as ``dancedata build`` does.

    Parameters
    ----------
    recipe
        Name of a recipe that comes with the package ("demo", "aist++"), path of a YAML file, or the document as a
        dict. A folder with recipe.yaml, as ``dancedata init`` writes it, is the source too. Or the address of a
        publication, or its folder: then the dataset is built from your source by the published recipe, and compared.
    source
        Folder with the dataset's files. None: only for a dataset that is generated, such as "demo"; its files are
        written to ``OUT-source``.
    out
        Folder to write. Default: ``data/NAME`` in the working folder.
    dry_run
        Return what would be built, a `Plan`: only lengths are read, and nothing is written to `out`.
    overrides
        Keys of the recipe to change: ``{"windows.stride_s": 1}``, or ``["windows.stride_s=1"]`` as on the command
        line.
    jobs
        Worker processes. Default: one per core. The result does not depend on it.
    overwrite
        Replace a dataset in `out` that was built from another recipe or source.
    strict
        Raise an error at a broken clip instead of setting it aside.
    cache
        Folder of the cache. Default: $DANCEDATA_CACHE, else the user's cache folder.
    backend, scheduler
        A cluster, on whose workers units run; `jobs` does not count then. `scheduler` is its address:
        "tcp://HOST:8786" (Dask), "ray://HOST:10001" or "ray://auto". `backend` follows from it. Default: processes of
        this machine ("loky").
    progress
        Show progress on stderr: a bar on a terminal or in a notebook, lines elsewhere.

    Returns
    -------
    BuildResult
        Path, counts per split, counts of rejects by reason; `open()` opens the dataset. A dataset that was
        built before from the same recipe and source is left unchanged. `rebuilt`: whether it has the bytes
        of the publication.

    Raises
    ------
    UsageError
        For an unknown recipe, a missing source, or `jobs` below 1; as RecipeError for a recipe that is wrong.
    SourceError, StoreError
        If the source or `out` cannot be used, or no clip is left to build from.
    DataError
        With `strict`, for the broken clips.

    Examples
    --------
    >>> import dancedata
    >>> built = dancedata.build("aist++", "~/aist_plusplus_final", "data/new", overrides={"windows.stride_s": 1})
    >>> built.counts["train"]["windows"], built.left_out
    (4, {})
    >>> ds = built.open()
    """
    if dry_run:
        from dancedata.building.plan import make_plan

        return make_plan(recipe, source, out, overrides=overrides, jobs=jobs, cache=cache, progress=progress)
    arguments = BuildArguments.of(recipe, source, out, overrides)
    reporter, published = Progress(quiet=not progress), arguments.published
    reporter.announce(f"building {arguments.recipe.name} from {arguments.source} into {arguments.out}")
    for note in () if published is None else published.missing_beside(arguments.source):
        reporter.write(note)
    return _build(
        arguments.recipe, arguments.source, arguments.out, jobs=jobs_of(jobs), overwrite=overwrite, strict=strict,
        cache=folder_of(cache), progress=reporter, backend=backend, scheduler=scheduler, published=published,
    )  # fmt: skip
