"""dancedata info: a dataset, a recipe, a plug-in, weights, lists of them, and this installation."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dancedata.cli.command import Output, command
from dancedata.core.errors import UsageError, did_you_mean


@command(
    "plugins",
    what="WHAT: A dataset, a recipe, a plug-in, a protocol, or a folder of weights; recipes, protocols, targets, "
    "features, representations or plugins for a list; without WHAT: this installation.",
    clips="List every clip of a dataset, with its windows.",
    segments="List the layers of a dataset's segments.",
)
def info(what: str = "", *, clips: bool = False, segments: bool = False) -> Any:
    """Describe a dataset, a recipe, a plug-in, this installation.

    dancedata info data/aistpp --clips
    dancedata info recipes
    dancedata info edge151
    """
    from dancedata.cli.plugins import LISTS, catalogue, describe_catalogue

    if what in LISTS:
        document = catalogue(what)
        more = "dancedata info NAME describes one, with its keys"
        return Output(lambda: document, lambda: "\n".join([*describe_catalogue(document), more]))
    from dancedata.files.addresses import is_address

    is_dataset = is_address(what) or (Path(what) / "dataset.json").exists()
    if (clips or segments) and not is_dataset:
        raise UsageError("--clips and --segments list what a dataset has", where=what or None, found="no dataset")
    if not what:
        from dancedata.cli.installation import installation

        return installation()
    if segments:
        from dancedata.segments.command import segments as run_segments

        return run_segments(what)
    described = [] if is_dataset else list(_described(what))
    if described:
        document = {key: value for entry, _ in described for key, value in entry.items()}
        return Output(lambda: document, lambda: "\n".join(line for _, lines in described for line in lines))
    if is_dataset or "/" in what or Path(what).exists():  # an error says what is missing
        from dancedata.building.describe import clip_rows, describe_clips, describe_store, store_json

        path = Path(what)
        return Output(
            lambda: store_json(path) | ({"clips": clip_rows(path)} if clips else {}),
            lambda: "\n".join([describe_store(path), *([describe_clips(path)] if clips else [])]),
        )
    from dancedata.recipes.parse import recipe_names

    names = [name for entries in catalogue("plugins").values() for name in entries]
    raise UsageError(f"unknown {what!r}", fix=did_you_mean(what, [*LISTS, "protocols"], [*recipe_names(), *names]))


def _described(what: str) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Yield each thing of this name, as JSON and as text: a recipe, plug-ins of several kinds, a protocol."""
    from dancedata.cli.plugins import catalogue, describe_catalogue

    if Path(what).is_dir():
        yield from _weights(Path(what))
        return
    yield from _recipe(what)
    of_kind = {kind: {what: entries[what]} for kind, entries in catalogue("plugins").items() if what in entries}
    if of_kind:
        yield {kind: entry[what] for kind, entry in of_kind.items()}, list(describe_catalogue(of_kind, whole=True))
    from dancedata.evaluation.protocol_text import describe_protocols, protocols_json

    protocols = protocols_json()
    if what == "protocols":
        yield protocols, describe_protocols().split("\n")
    elif what in protocols:
        yield protocols[what], describe_protocols(what).split("\n")


def _recipe(what: str) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Yield a recipe: its description and its keys, defaults included."""
    from dancedata.recipes.parse import load_recipe, recipe_names

    if what not in recipe_names() and Path(what).suffix not in (".yaml", ".yml"):
        return
    import yaml

    recipe = load_recipe(what)
    dumped = yaml.safe_dump(recipe.document, sort_keys=False, allow_unicode=True, width=80, default_flow_style=None)
    cite = [f"# licence of the data: {recipe.dataset.licence}", f"# cite: {recipe.dataset.citation}"]
    yield dict(recipe.document), [f"# {recipe.description or recipe.name}", *cite, dumped.rstrip()]


def _weights(folder: Path) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Yield where the weights in a folder come from."""
    from dancedata.audio.hf.model_folder import PROVENANCE
    from dancedata.files.strict_json import read_json

    if (folder / PROVENANCE).is_file():
        about = read_json(folder / PROVENANCE, 1 << 20)
        yield about, [f"{key}: {value}" for key, value in about.items() if isinstance(value, str | int)]
