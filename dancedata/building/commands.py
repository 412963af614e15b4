"""build, plan and check from Python; the command line calls the same functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from dancedata.building.build import BuildResult
from dancedata.building.build import build as _build
from dancedata.core.errors import UsageError
from dancedata.execution.addresses import local_folder
from dancedata.execution.progress import Progress
from dancedata.recipes.parse import Overrides, load_recipe, recipe_names
from dancedata.recipes.recipe import Recipe

if TYPE_CHECKING:
    from dancedata.building.part import PartResult
    from dancedata.building.plan import Plan
    from dancedata.building.rebuild import Published
    from dancedata.store import Problem

__all__ = ["build", "build_part", "check", "plan"]

#: Files that show that a folder is a dataset or a publication.
_PUBLISHED = ("dataset.json", "publication.json")
#: A recipe's name, its YAML file, its document, a parsed recipe; or the address or folder of a publication.
RecipeLike = str | Path | Mapping[str, Any] | Recipe


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
        return plan(recipe, source, out, overrides=overrides, jobs=jobs, cache=cache, progress=progress)
    request = _Request.of(recipe, source, out, overrides)
    reporter = Progress(quiet=not progress)
    reporter.announce(f"building {request.recipe.name} from {request.source} into {request.out}")
    for note in () if request.published is None else request.published.missing_beside(request.source):
        reporter.write(note)
    return _build(
        request.recipe, request.source, request.out, jobs=jobs_of(jobs), overwrite=overwrite, strict=strict,
        cache=folder_of(cache), progress=reporter, backend=backend, scheduler=scheduler, published=request.published,
    )  # fmt: skip


def build_part(
    recipe: RecipeLike,
    source: str | Path | None,
    part: str,
    *,
    out: str | Path | None = None,
    overrides: Overrides = (),
    jobs: int | None = None,
    strict: bool = False,
    cache: str | Path | None = None,
    progress: bool = True,
) -> PartResult:
    """Compute a share of a build into the cache, as ``dancedata build --part 3/16`` does; no dataset is written.

    Parameters
    ----------
    part
        "3/16": the third of sixteen shares. `build` afterwards collects what all shares have computed.
    recipe, source, out, overrides, jobs, strict, cache, progress
        As in `build`; `out` only names the source of a dataset that is generated.

    Returns
    -------
    PartResult
        Clips and songs of the share, and counts of clips that will be left out.
    """
    from dancedata.building.part import Part
    from dancedata.building.part import build_part as run

    request = _Request.of(recipe, source, out, overrides)
    reporter = Progress(quiet=not progress)
    reporter.announce(f"computing part {part} of {request.recipe.name} from {request.source}")
    return run(
        request.recipe, request.source, Part.parse(part), jobs=jobs_of(jobs), strict=strict, cache=folder_of(cache),
        progress=reporter,
    )  # fmt: skip


def plan(
    recipe: RecipeLike,
    source: str | Path | None = None,
    out: str | Path | None = None,
    *,
    overrides: Overrides = (),
    jobs: int | None = 1,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Plan:
    """Plan a build, as ``dancedata build --dry-run`` does.

    Only lengths are read. No feature is computed and nothing is written to `out`; a dataset that is generated writes
    its source if that is missing.

    Parameters
    ----------
    recipe, source, out, overrides, cache, progress
        As in `build`.
    jobs
        Worker processes; None: one per core.

    Returns
    -------
    Plan
        `summary` is the text that the command prints, `to_json()` the same as data: clips, windows, columns, bytes,
        reasons for which clips would be left out, and the share of each field in the cache.

    Raises
    ------
    UsageError
        As for `build`.
    SourceError
        If the source cannot be used. `Plan.problem` is the error of a build that no clip is left for.

    Examples
    --------
    >>> import dancedata
    >>> print(dancedata.plan("aist++", "~/aist_plusplus_final").summary)
    aist++: about 524 kB
      30 frames per second, windows of 150 frames every 15
      split  clips  windows  frames  songs
      train      2        6     360      1
    ...
    """
    from dancedata.building.plan import make_plan

    request = _Request.of(recipe, source, out, overrides)
    reporter = Progress(quiet=not progress)
    if not request.source.exists() and request.recipe.dataset.generates:
        reporter.write(f"the dataset {request.recipe.dataset.name} writes its own source: {request.source}")
    return make_plan(request.recipe, request.source, jobs=jobs_of(jobs), cache=folder_of(cache), progress=reporter)


def check(
    path: str | Path,
    *others: str | Path,
    dataset: str | None = None,
    recipe: RecipeLike | None = None,
    overrides: Overrides = (),
    jobs: int | None = 1,
    progress: bool = True,
) -> list[Problem]:
    """Check a built dataset or a source folder, as ``dancedata check`` does.

    Parameters
    ----------
    path
        Folder that `build` wrote or the address of one, or a folder to build from.
    others
        Further folders that `build` wrote: each is checked, and then what any two of them share, such as a song that
        train of one and test of another have.
    dataset
        Reader of a source folder, such as "aist++". Default: the first one that recognises it.
    recipe, overrides
        Read a source folder as this recipe does. Default: recipe.yaml in the folder, if `dataset` is not given.
    jobs
        Worker processes for a source folder; None: one per core.
    progress
        As in `build`.

    Returns
    -------
    list of Problem
        Each with `severity` ("error" or "note"), `where` and `message`. Without an error the folder is sound.

    Raises
    ------
    UsageError
        For an unknown dataset or recipe.
    SourceError
        If the folder is neither a built dataset nor a source of a known one.

    Examples
    --------
    >>> import dancedata
    >>> [problem for problem in dancedata.check("data/aistpp") if problem.severity == "error"]
    []
    """
    from dancedata.building.check import check as run
    from dancedata.building.check import check_several

    paths, reporter = [local_folder(p) for p in (path, *others)], Progress(quiet=not progress)
    if others:
        if recipe is not None or dataset is not None or overrides:
            raise UsageError("built datasets are compared, which have no reader", fix="leave out dataset and recipe")
        return check_several(paths)
    parsed = recipe_of(path, recipe, dataset, overrides)
    return run(paths[0], dataset=dataset, recipe=parsed, jobs=jobs_of(jobs), progress=reporter)


@dataclass(frozen=True)
class _Request:
    """A recipe, the folder it reads and the folder it writes; the publication that the recipe is of, if any."""

    recipe: Recipe
    source: Path
    out: Path
    published: Published | None

    @classmethod
    def of(
        cls, recipe: RecipeLike, source: str | Path | None, out: str | Path | None, overrides: Overrides
    ) -> _Request:
        prepared = _prepared(recipe) if isinstance(recipe, str | Path) and source is None else None
        if prepared is not None:
            recipe, source = prepared, prepared.parent
        published = _published(recipe)
        parsed = load_recipe(recipe, overrides) if published is None else published.recipe(overrides)
        target = folder_of(out) or Path("data") / parsed.name
        if source is not None:
            return cls(parsed, Path(source).expanduser(), target, published)
        if parsed.dataset.generates:
            return cls(parsed, target.parent / f"{target.name}-source", target, published)
        raise UsageError(f"the dataset {parsed.dataset.name} needs a source",
                         fix=f"name the folder with its files: dancedata build {parsed.name} SOURCE, "
                         "or source=DIR in Python")  # fmt: skip


def recipe_of(
    folder: str | Path, recipe: RecipeLike | None, dataset: str | None, overrides: Overrides
) -> Recipe | None:
    """Return the recipe that reads a source folder, by default its own recipe.yaml; None if a dataset's reader does.

    UsageError if both a recipe and a dataset choose the reader, or overrides have no recipe.
    """
    if recipe is None and dataset is None:
        recipe = _prepared(folder)
    if recipe is not None and dataset is not None:
        raise UsageError("dataset and recipe both choose a reader", fix="give one of them")
    if overrides and recipe is None:
        raise UsageError("--set, or overrides, change keys of a recipe", fix="name a recipe, not a reader alone")
    return None if recipe is None else load_recipe(recipe, overrides)


def _prepared(folder: str | Path) -> Path | None:
    """Return recipe.yaml of a folder that ``dancedata init`` prepared; None for a dataset, and without one."""
    path = Path(folder).expanduser()
    published = any((path / name).exists() for name in _PUBLISHED)
    return path / "recipe.yaml" if (path / "recipe.yaml").is_file() and not published else None


def _published(recipe: RecipeLike) -> Published | None:
    """Return the publication at an address or in a folder; None if that names a recipe."""
    if not isinstance(recipe, str | Path) or str(recipe) in recipe_names():
        return None
    from dancedata.building.rebuild import Published

    return Published.at(recipe)


def folder_of(path: str | Path | None) -> Path | None:
    """Return a path with ~ expanded; None for None."""
    return None if path is None else Path(path).expanduser()


def jobs_of(jobs: int | None) -> int:
    """Return a number of worker processes: one per core for None; UsageError below 1."""
    if jobs is None:
        from joblib import cpu_count

        return int(cpu_count())
    if jobs < 1:
        raise UsageError("invalid number of worker processes", found=jobs, allowed="1 and above, or None")
    return jobs
