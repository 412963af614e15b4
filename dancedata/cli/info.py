"""dancedata info: a dataset, a recipe, a plug-in, weights, lists of them, and this installation."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.command import Output, command
from dancedata.cli.options import Plugins, option
from dancedata.core.errors import UsageError, did_you_mean

WHAT_HELP = (
    "A dataset, a recipe, a plug-in, a protocol, or a folder of weights; recipes, protocols, targets, features, "
    "representations or plugins for a list; nothing: this installation."
)


@command
def info(
    what: Annotated[str, typer.Argument(metavar="WHAT", help=WHAT_HELP)] = "",
    clips: Annotated[bool, option("--clips", help="List every clip of a dataset, with its windows.")] = False,
    segments: Annotated[bool, option("--segments", help="List the layers of a dataset's segments.")] = False,
    plugins: Plugins = None,
) -> Output:
    """Describe a dataset, a recipe, a plug-in, this installation.

    dancedata info data/aistpp --clips
    dancedata info recipes
    dancedata info edge151
    """
    from dancedata.cli.plugins import LISTS, catalogue, describe_catalogue

    if what in LISTS:
        document = catalogue(what)
        return Output(lambda: document, lambda: "\n".join(describe_catalogue(document)))
    from dancedata.execution.addresses import is_address

    is_dataset = is_address(what) or (Path(what) / "dataset.json").exists()
    if (clips or segments) and not is_dataset:
        raise UsageError("--clips and --segments list what a dataset has", where=what or None, found="no dataset")
    if not what:
        from dancedata.cli.installation import installation

        return installation()
    if segments:
        from dancedata.segments.command import segments as run_segments

        result = run_segments(what)
        return Output(result.to_json, lambda: str(result))
    if is_dataset:
        return _dataset(Path(what), clips=clips)
    if (entry := next(_entries(what), None)) is not None:
        return Output(lambda: entry[0], lambda: "\n".join(entry[1]))
    if "/" in what or Path(what).exists():
        return _dataset(Path(what), clips=clips)  # its error says what is missing
    raise _unknown(what)


def _dataset(path: Path, *, clips: bool) -> Output:
    from dancedata.building.describe import clip_rows, describe_clips, describe_store, store_json

    return Output(
        lambda: store_json(path) | ({"clips": clip_rows(path)} if clips else {}),
        lambda: "\n".join([describe_store(path), *([describe_clips(path)] if clips else [])]),
    )


def _entries(what: str) -> Iterator[tuple[Any, list[str]]]:
    """Yield what has this name, as JSON and as text; the first counts."""
    from dancedata.cli.plugins import catalogue, describe_catalogue

    if what == "protocols":
        from dancedata.evaluation.protocol_text import describe_protocols, protocols_json

        yield protocols_json(), describe_protocols().split("\n")
    elif Path(what).is_dir():
        yield from _weights(Path(what))
    else:
        yield from _recipe(what)
        of_kind = {kind: entries[what] for kind, entries in catalogue("plugins").items() if what in entries}
        if of_kind:
            yield of_kind, describe_catalogue({kind: {what: entry} for kind, entry in of_kind.items()})
        from dancedata.evaluation.protocol_text import describe_protocols, protocols_json

        if what in (protocols := protocols_json()):
            yield protocols[what], describe_protocols(what).split("\n")


def _recipe(what: str) -> Iterator[tuple[Any, list[str]]]:
    """Yield a recipe: its description and its keys, defaults included."""
    from dancedata.recipes.parse import load_recipe, recipe_names

    if what not in recipe_names() and Path(what).suffix not in (".yaml", ".yml"):
        return
    import yaml

    recipe = load_recipe(what)
    document = recipe.document
    dumped = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100, default_flow_style=None)
    cite = [f"# licence of the data: {recipe.dataset.licence}", f"# cite: {recipe.dataset.citation}"]
    yield document, [f"# {recipe.description or recipe.name}", *cite, dumped.rstrip()]


def _weights(folder: Path) -> Iterator[tuple[Any, list[str]]]:
    """Yield where the weights in a folder come from."""
    from dancedata.audio.hf.model_folder import PROVENANCE
    from dancedata.audio.jukebox.weights.folder import DESCRIPTION_FILE
    from dancedata.files.strict_json import read_json

    for name in (PROVENANCE, DESCRIPTION_FILE):
        if (folder / name).is_file():
            about = read_json(folder / name, 1 << 20)
            yield about, [f"{key}: {value}" for key, value in about.items() if isinstance(value, str | int)]


def _unknown(what: str) -> UsageError:
    from dancedata.cli.plugins import LISTS, catalogue
    from dancedata.recipes.parse import recipe_names

    names = [name for entries in catalogue("plugins").values() for name in entries]
    return UsageError(f"unknown {what!r}", fix=did_you_mean(what, [*LISTS, "protocols"], [*recipe_names(), *names]))
