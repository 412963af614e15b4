"""dancedata init, build, check: from captures to a dataset without faults."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.command import Output, command
from dancedata.cli.help import RARE
from dancedata.cli.options import CacheFolder, Cluster, Jobs, Overwrite, Plugins, Quiet, Set, option
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import counted

KIND_HELP = "Write a plug-in of this kind and its test: FOLDER is its name. dancedata info plugins lists the kinds."
IN_TREE_HELP = "Write it where it belongs in a checkout of dancedata; a dataset with recipe, page and test."
RECIPE_HELP = (
    "A recipe (dancedata info recipes), a YAML file, a folder with recipe.yaml, a built dataset, or an address."
)
READ_AS_HELP = "Read a source folder as this recipe does; default: its recipe.yaml."
SOURCE_HELP = "Folder with the downloaded files; not needed for demo, nor for a folder with recipe.yaml."
SEGMENTS_HELP = "Of a built dataset: words, moves and marks (.csv, .jsonl) that replace its own of the same layer."
PART_HELP = "Compute one of N shares into the cache, for job arrays."
ATOL_HELP = "With --same-as: numbers that differ by no more are the same."


@command
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Motion files and songs of your own.")],
    out: Annotated[Path | None, option("-o", "--out", metavar="DIR", help="Write there; default FOLDER.")] = None,
    offsets: Annotated[bool, option("--offsets", help="Estimate where each dance begins in its song.")] = False,
    plugin_kind: Annotated[str | None, option(metavar="KIND", help=KIND_HELP)] = None,
    in_tree: Annotated[bool, option("--in-tree", help=IN_TREE_HELP)] = False,
    jobs: Jobs = None,
    cache: CacheFolder = None,
    quiet: Quiet = False,
) -> Output:
    """Prepare a folder of your own captures: manifest.csv, recipe.yaml.

      dancedata init captures
      dancedata init captures --offsets
      dancedata init waltz --plugin-kind metric

    The manifest pairs motion and songs, with the evidence; what is a guess is marked. A second run fills empty cells
    and never changes one that is filled.
    """
    if plugin_kind is not None:
        from dancedata.cli.plugins import write_plugin

        plugin = write_plugin(plugin_kind, str(folder), out or Path(), in_tree=in_tree)
        return Output(plugin.to_json, lambda: str(plugin))
    if in_tree:
        raise UsageError(
            "--in-tree goes with --plugin-kind", fix="dancedata init NAME --plugin-kind dataset --in-tree"
        )
    from dancedata.datasets.folder.prepare import fill_starts, prepare

    prepared = prepare(folder, out)
    if offsets:
        from dancedata.alignment.align import align

        if out is not None:
            raise UsageError("offsets are of the manifest that is beside the files", fix="leave --out away")
        alignment = align(folder, jobs=jobs, cache=cache, progress=not quiet)
        starts = {
            clip.id: start
            for row in alignment.rows
            for clip in row.clips
            if (start := row.start_of(clip)) is not None
        }
        prepared = fill_starts(prepared, starts, str(alignment))
    return Output(prepared.to_json, lambda: str(prepared), warnings=prepared.warnings)


@command
def build(
    recipe: Annotated[str, typer.Argument(metavar="RECIPE", help=RECIPE_HELP)],
    source: Annotated[Path | None, typer.Argument(metavar="SOURCE", help=SOURCE_HELP)] = None,
    out: Annotated[
        Path | None, option("-o", "--out", metavar="DIR", help="Folder of the dataset; default data/NAME.")
    ] = None,
    overrides: Set = None,
    dry_run: Annotated[
        bool, option("--dry-run", help="Show clips, windows, columns and bytes; build nothing.")
    ] = False,
    strict: Annotated[
        bool, option("--strict", help="Stop at a broken clip; exit code 1 if train shares songs.")
    ] = False,
    overwrite: Overwrite = False,
    jobs: Jobs = None,
    segments: Annotated[Path | None, option(metavar="FILE", help=SEGMENTS_HELP, panel=RARE)] = None,
    part: Annotated[str | None, option(metavar="K/N", help=PART_HELP, panel=RARE)] = None,
    cluster: Cluster = None,
    cache: CacheFolder = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Build a dataset from motion and music.

      dancedata build demo
      dancedata build aist++ ~/aist_plusplus_final
      dancedata build captures            (a folder that "dancedata init" prepared)

    A broken clip is left out and listed in rejects.jsonl. The same command again resumes a build that was stopped.
    """
    from dancedata.building import commands
    from dancedata.building.describe import store_json

    options: dict[str, Any] = {"overrides": overrides or (), "jobs": jobs, "cache": cache, "progress": not quiet}
    if segments is not None:
        from dancedata.segments.command import segments as set_segments

        result = set_segments(recipe, set_file=segments)
        return Output(result.to_json, lambda: str(result))
    if dry_run:
        plan = commands.build(recipe, source, out, dry_run=True, **options)
        text = plan.describe(out or Path("data") / plan.recipe.name)
        return Output(plan.to_json, lambda: text, error=plan.problem)
    if part is not None:
        if cluster is not None or overwrite:
            raise UsageError("--part goes with neither --cluster nor --overwrite")
        from dancedata.building.part import Part, build_part

        share = build_part(recipe, source, Part.parse(part), out=out, strict=strict, **options)
        return Output(share.to_json, lambda: str(share))
    started = time.monotonic()
    built = commands.build(recipe, source, out, overwrite=overwrite, strict=strict, scheduler=cluster, **options)
    if built.built and not quiet:
        say(f"built in {time.monotonic() - started:.1f} s", err=True)
    leaks = [problem.message for problem in built.shared or () if problem.severity == "error"]
    compared = {} if built.rebuilt is None else {"rebuilt": built.rebuilt}
    return Output(
        lambda: {"built": built.built, **store_json(built.path), **compared}, lambda: built.summary,
        ok=built.rebuilt is not False and not (strict and leaks), warnings=leaks,
    )  # fmt: skip


@command
def check(
    paths: Annotated[list[str], typer.Argument(metavar="PATH...", help="Source folders, or built datasets.")],
    recipe: Annotated[str | None, option(metavar="RECIPE", help=READ_AS_HELP)] = None,
    overrides: Set = None,
    faults: Annotated[bool, option("--faults", help="Score spikes, sliding, bones, ... of each clip.")] = False,
    offsets: Annotated[bool, option("--offsets", help="Estimate offsets between music and motion.")] = False,
    published: Annotated[
        bool, option("--published", help="Compare a copy of AIST++ or FineDance with published scores.")
    ] = False,
    same_as: Annotated[Path | None, option(metavar="DATASET", help="Show how a dataset differs from it.")] = None,
    atol: Annotated[float | None, option(metavar="X", help=ATOL_HELP)] = None,
    out: Annotated[
        Path | None, option("-o", "--out", metavar="FILE.csv", help="A line for each fault or offset.")
    ] = None,
    jobs: Jobs = None,
    cache: CacheFolder = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Find what is wrong with files, or with a dataset.

      dancedata check ~/aist_plusplus_final
      dancedata check data/aistpp data/finedance      (and what they share)
      dancedata check data/aistpp --faults

    Changes no file. Exit code 1 if something is wrong.
    """
    asked = [faults, offsets, published, same_as is not None]
    if sum(asked) > 1:
        raise UsageError("--faults, --offsets, --published and --same-as are checks by themselves", fix="call each")
    if any(asked) and len(paths) > 1:
        raise UsageError("this check takes one folder", found=counted(len(paths), "folder"), fix="call it for each")
    if (atol is not None and same_as is None) or (out is not None and not (faults or offsets)):
        raise UsageError("--atol goes with --same-as, and --out with --faults or --offsets", fix="leave it out")
    how: dict[str, Any] = {
        **_reader(recipe), "overrides": overrides or (), "jobs": jobs, "progress": not quiet,
    }  # fmt: skip
    if faults:
        from dancedata.curation.quality import quality

        scored = quality(paths[0], out=out, cache=cache, **how)
        return Output(scored.to_json, lambda: str(scored))
    if offsets:
        from dancedata.alignment.align import align

        aligned = align(Path(paths[0]), out=out, cache=cache, **how)
        return Output(aligned.to_json, lambda: str(aligned))
    if published:
        from dancedata.evaluation.run import self_test

        tested = self_test(paths[0], jobs=jobs, cache=cache, progress=not quiet)
        return Output(tested.to_json, lambda: str(tested))
    if same_as is not None:
        return _same(Path(paths[0]), same_as, atol)
    from dancedata.building.check import check as run_check
    from dancedata.building.describe import describe_problems

    problems = run_check(*paths, **how)
    return Output(
        lambda: {"paths": paths, "problems": [problem.to_json() for problem in problems]},
        lambda: describe_problems(" and ".join(paths), problems),
        ok=not any(problem.severity == "error" for problem in problems),
    )


def _reader(recipe: str | None) -> dict[str, str | None]:
    """Return how a source folder is read: as a recipe does, or by the reader of this name."""
    from dancedata.core.registry import DATASETS
    from dancedata.recipes.parse import recipe_names

    is_reader = recipe is not None and recipe not in recipe_names() and recipe in DATASETS.names()
    return {"dataset": recipe} if is_reader else {"recipe": recipe}


def _same(a: Path, b: Path, atol: float | None) -> Output:
    """Compare two datasets."""
    from dancedata.comparison import diff

    compared = diff(a, b, atol=atol)
    n = sum(difference.kind != "note" for difference in compared)
    same = "the same data" + (f" within {atol:g}" if atol is not None else "")
    listed = [difference.to_json() for difference in compared]
    return Output(
        lambda: {"a": str(a), "b": str(b), "atol": atol, "same": not n, "differences": listed},
        lambda: "\n".join([*compared.lines(), counted(n, "difference") if n else same]),
        ok=not n,
    )
