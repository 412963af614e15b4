"""What builds, plans, parts and checks are asked for: a recipe, a source, an output folder, a number of processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.core.arguments import Overrides, folder_of
from dancedata.core.errors import UsageError
from dancedata.recipes.parse import load_recipe, recipe_names
from dancedata.recipes.recipe import Recipe

if TYPE_CHECKING:
    from dancedata.building.rebuild import Publication

#: Files that show that a folder is a dataset or a publication.
_PUBLISHED = ("dataset.json", "publication.json")
#: A recipe's name, its YAML file, its document, a parsed recipe; or the address or folder of a publication.
RecipeLike = str | Path | Mapping[str, Any] | Recipe


@dataclass(frozen=True)
class BuildArguments:
    """A recipe, the folder it reads and the folder it writes; the publication that the recipe comes from, if any."""

    recipe: Recipe
    source: Path
    out: Path
    published: Publication | None

    @classmethod
    def of(
        cls, recipe: RecipeLike, source: str | Path | None, out: str | Path | None, overrides: Overrides
    ) -> BuildArguments:
        """Read arguments as `build` takes them."""
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


def chosen_recipe(
    folder: str | Path, recipe: RecipeLike | None, dataset: str | None, overrides: Overrides
) -> Recipe | None:
    """Return the recipe that reads a source folder, by default its recipe.yaml; None if a dataset's reader does."""
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


def _published(recipe: RecipeLike) -> Publication | None:
    """Return the publication at an address or in a folder; None if that names a recipe."""
    if not isinstance(recipe, str | Path) or str(recipe) in recipe_names():
        return None
    from dancedata.building.rebuild import Publication

    return Publication.at(recipe)


def jobs_of(jobs: int | None) -> int:
    """Return a number of worker processes: one per core for None; UsageError below 1."""
    if jobs is None:
        from joblib import cpu_count

        return int(cpu_count())
    if jobs < 1:
        raise UsageError("invalid number of worker processes", found=jobs, allowed="1 and above")
    return jobs
