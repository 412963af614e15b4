"""dancedata init, build, check: from captures to a dataset without faults."""

import time
from pathlib import Path
from typing import Any

from dancedata.cli.command import Output, command
from dancedata.cli.help import RARE
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import counted


@command(
    "jobs cache quiet",
    folder="FOLDER: Motion files and songs of your own.",
    out="DIR: Write there; default FOLDER.",
    offsets="Estimate where each dance begins in its song.",
    plugin_kind="KIND: Write a plug-in of this kind, such as metric, and its test: FOLDER is its name.",
    in_tree="Write it where it belongs in a checkout of dancedata; a dataset gets a recipe, page and test.",
)
def init(
    folder: Path, *, out: Path | None = None, offsets: bool = False, plugin_kind: str | None = None,
    in_tree: bool = False, **how: Any,
) -> Any:  # fmt: skip
    """Prepare a folder of your own captures: manifest.csv, recipe.yaml.

      dancedata init captures
      dancedata init captures --offsets
      dancedata init waltz --plugin-kind metric

    The manifest pairs motion and songs, with the evidence; what is a guess is marked. A second run fills empty cells
    and never changes one that is filled.
    """
    if plugin_kind is not None:
        from dancedata.cli.plugins import write_plugin

        return write_plugin(plugin_kind, str(folder), out or Path(), in_tree=in_tree)
    if in_tree:
        raise UsageError("--in-tree needs --plugin-kind", fix="dancedata init NAME --plugin-kind dataset --in-tree")
    from dancedata.datasets.folder.prepare import fill_starts, prepare

    prepared = prepare(folder, out)
    if offsets:
        from dancedata.alignment.align import align

        if out is not None:
            raise UsageError("offsets are written to the manifest beside the files", fix="omit --out")
        alignment = align(folder, **how)
        starts = {
            clip.id: start
            for row in alignment.rows
            for clip in row.clips
            if (start := row.start_of(clip)) is not None
        }
        prepared = fill_starts(prepared, starts, str(alignment))
    return Output(prepared.to_json, lambda: str(prepared), warnings=prepared.warnings)


@command(
    "overrides overwrite jobs cluster cache plugins quiet",
    recipe="RECIPE: A recipe (dancedata info recipes), a YAML file, a folder with recipe.yaml, a built dataset, or "
    "an address.",
    source="SOURCE: Folder with the downloaded files; not needed for demo, nor for a folder with recipe.yaml.",
    out="DIR: Folder of the dataset; default data/NAME.",
    dry_run="Show clips, windows, columns and bytes; build nothing.",
    strict="Stop at a broken clip; exit code 1 if train shares songs.",
    segments=(
        RARE,
        "FILE: For a built dataset: words, moves and marks (.csv, .jsonl) that replace those of the same layer.",
    ),
    part=(RARE, "K/N: Compute one of N shares into the cache, for job arrays."),
)
def build(
    recipe: str, source: Path | None = None, *, out: Path | None = None, dry_run: bool = False, strict: bool = False,
    segments: Path | None = None, part: str | None = None, overwrite: bool, cluster: str | None, **how: Any,
) -> Any:  # fmt: skip
    """Build a dataset from motion and music.

      dancedata build demo
      dancedata build aist++ ~/aist_plusplus_final
      dancedata build captures            (a folder that "dancedata init" prepared)

    A broken clip is left out and listed in rejects.jsonl. The same command again resumes a build that was stopped.
    """
    from dancedata.building import commands
    from dancedata.building.describe import store_json

    if segments is not None:
        from dancedata.segments.command import segments as set_segments

        return set_segments(recipe, set_file=segments)
    if dry_run:
        plan = commands.build(recipe, source, out, dry_run=True, **how)
        text = plan.describe(out or Path("data") / plan.recipe.name)
        return Output(plan.to_json, lambda: text, error=plan.problem)
    if part is not None:
        if cluster is not None or overwrite:
            raise UsageError("--part cannot be combined with --cluster or --overwrite")
        from dancedata.building.part import Part, build_part

        return build_part(recipe, source, Part.parse(part), out=out, strict=strict, **how)
    started = time.monotonic()
    built = commands.build(recipe, source, out, overwrite=overwrite, strict=strict, scheduler=cluster, **how)
    if built.built and how["progress"]:
        say(f"built in {time.monotonic() - started:.1f} s", err=True)
    leaks = [problem.message for problem in built.shared or () if problem.severity == "error"]
    compared = {} if built.rebuilt is None else {"rebuilt": built.rebuilt}
    return Output(
        lambda: {"built": built.built, **store_json(built.path), **compared}, lambda: built.summary,
        ok=built.rebuilt is not False and not (strict and leaks), warnings=leaks,
    )  # fmt: skip


@command(
    "overrides jobs cache plugins quiet",
    paths="PATH...: Source folders, or built datasets.",
    recipe="RECIPE: Read a source folder as this recipe does; default: its recipe.yaml.",
    faults="Score spikes, sliding, bones, ... of each clip.",
    offsets="Estimate offsets between music and motion.",
    published="Compare a copy of AIST++ or FineDance with published scores.",
    same_as="DATASET: Show how a dataset differs from it.",
    atol="X: With --same-as: numbers that differ by no more than X count as equal.",
    out="FILE.csv: A line for each fault or offset.",
)
def check(
    paths: list[str], *, recipe: str | None = None, faults: bool = False, offsets: bool = False,
    published: bool = False, same_as: Path | None = None, atol: float | None = None, out: Path | None = None,
    cache: Path | None, **how: Any,
) -> Any:  # fmt: skip
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
        raise UsageError("--atol needs --same-as, and --out needs --faults or --offsets", fix="omit it")
    reader = _reader(recipe)
    if faults:
        from dancedata.curation.quality import quality

        scored = quality(paths[0], out=out, cache=cache, **reader, **how)
        return Output(scored.to_json, lambda: str(scored), ok=bool(scored.clips))
    if offsets:
        from dancedata.alignment.align import align

        aligned = align(paths[0], out=out, cache=cache, **reader, **how)
        return Output(aligned.to_json, lambda: str(aligned), ok=bool(aligned.rows))
    if published:
        from dancedata.evaluation.self_test import self_test

        return self_test(paths[0], jobs=how["jobs"], cache=cache, progress=how["progress"])
    if same_as is not None:
        return _same(Path(paths[0]), same_as, atol)
    from dancedata.building.check import check as run_check
    from dancedata.building.describe import describe_problems

    problems = run_check(paths[0], *paths[1:], **reader, **how)
    return Output(
        lambda: {"paths": paths, "problems": [problem.to_json() for problem in problems]},
        lambda: describe_problems(" and ".join(paths), problems),
        ok=not any(problem.severity == "error" for problem in problems),
    )


def _reader(recipe: str | None) -> dict[str, Any]:
    """Return how a source folder is read: as a recipe does, or by the reader of this name."""
    from dancedata.core.registry import DATASETS
    from dancedata.recipes.parse import recipe_names

    is_reader = recipe is not None and recipe not in recipe_names() and recipe in DATASETS.names()
    return {"dataset" if is_reader else "recipe": recipe}


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
