"""The conformance check of exports."""

from fractions import Fraction
from pathlib import Path

from dancedata.core.errors import StoreError
from dancedata.exports.base.job import Export
from dancedata.exports.base.run import export_dataset
from dancedata.files.atomic_folder import ABOUT, read_about
from dancedata.testing.plugin_checks import check_plugin, raises, require
from dancedata.testing.stores import random_fields, write_random_store


def check_export(cls: type[Export], folder: Path) -> None:
    """Check an export in an empty folder: its recipe suffices, bytes repeat, listed folders have no other files."""
    check_plugin(cls)
    plugin, folder = cls(), folder.absolute()
    source, store = _build_for_export(plugin, folder)
    outs = [folder / "one" / "export", folder / "two" / "export"]
    for out in outs:
        done = export_dataset(store, plugin, out, source=source, link=out is outs[1])
        require(done.path == out, "the result names the folder")
    _check_exported(plugin, *outs)
    raises(
        StoreError, lambda: export_dataset(store, plugin, outs[0], source=source), "a second one there is an error"
    )
    _check_refusal(plugin, folder, source)


def _build_for_export(plugin: Export, folder: Path) -> tuple[Path, Path]:
    """Build a small dataset from an export's own recipe; returns its source and the dataset."""
    from dancedata.building.build import build
    from dancedata.recipes.parse import parse_recipe

    document = {
        "recipe": 1,
        "name": "conformance",
        "dataset": {"aist++": {}},
        "windows": {"length_s": 5, "stride_s": 0.5},
        **plugin.recipe,
    }
    recipe, source, store = parse_recipe(document), folder / "source", folder / "store"
    recipe.dataset.make_example(source)
    build(recipe, source, store, cache=folder / "cache")
    return source, store


def _check_exported(plugin: Export, one: Path, two: Path) -> None:
    listed = [{p.relative_to(f).as_posix(): p for p in f.rglob("*") if p.is_file()} for f in (one, two)]
    require(listed[0].keys() == listed[1].keys(), "two exports have the same files")
    for name, path in listed[0].items():
        first_path, second_path = (str(folder).encode() for folder in (one, two))
        if name not in (ABOUT, "README.md"):  # these name the links, if there are any
            same = path.read_bytes().replace(first_path, second_path) == listed[1][name].read_bytes()
            require(same, f"two exports of a dataset have equal bytes: {name}")
    record = read_about(one)
    require(record is not None, "export.json is whole")
    require(record is not None and set(record["files"]) == listed[0].keys() - {ABOUT}, "export.json lists all files")
    for folder in plugin.listed_folders:
        require((one / folder).is_dir(), f"the folder {folder} that a loader lists exists")
    base_files = {"README.md", ABOUT, "LICENCE.txt"}
    inside = [name for name in listed[0] if Path(name).name in base_files and len(Path(name).parts) > 1]
    require(not inside, f"README, licence and export.json are not among the files of a loader: {inside}")
    require(len((one / "README.md").read_text(encoding="utf-8")) > 200, "README.md explains the files")
    leftovers = [p.name for p in one.parent.iterdir() if p != one]
    require(not leftovers, f"nothing is left next to the export: {leftovers}")


def _check_refusal(plugin: Export, folder: Path, source: Path) -> None:
    """Check the error for a dataset of two odd columns at an odd rate, where that is not enough."""
    fields = random_fields({"odd": 2}, {}, odd=10)
    bare = write_random_store(folder / "bare", fields=fields, fps=Fraction(10), length=20, stride=10).path
    try:
        export_dataset(bare, plugin, folder / "refused" / "export", source=source)
    except StoreError as error:
        require("fix: " in str(error), f"an error has the line of a recipe that helps: {error}")
        require(not (folder / "refused").exists(), "nothing is written where something is lacking")
