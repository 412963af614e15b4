"""Plug-ins of single files: `plugins` of a recipe, `--plugin`, their identity, worker processes and datasets."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import dancedata
from dancedata.building.build import build
from dancedata.building.check import check
from dancedata.cli.app import app
from dancedata.core.errors import RecipeError, StoreError, UsageError
from dancedata.core.registry import FEATURES, REGISTRIES
from dancedata.recipes.parse import load_recipe, parse_recipe
from dancedata.recipes.recipe import Recipe
from tests.messages import raises_message

pytestmark = pytest.mark.usefixtures("no_local_plugins")
FEATURE = (Path(__file__).parents[2] / "dancedata/cli/templates/feature.py").read_text()
REPRESENTATION = '''
from dataclasses import dataclass
from dancedata.core.registry import REPRESENTATIONS
from dancedata.representations.edge151 import Edge151

@REPRESENTATIONS.register("my_motion")
@dataclass(frozen=True)
class MyMotion(Edge151):
    """My columns."""
    version = 1
'''
RECIPE = """
recipe: 1
name: local
dataset: {aist++: {}}
windows: {length_s: 2, stride_s: 0.5}
motion: {edge151: {}}
audio: {loudness: {}, librosa35: {}}
plugins: [./loudness.py]
"""


def feature(folder: Path, factor: str = "1.0", file: str = "loudness.py") -> Path:
    path = folder / file
    text = FEATURE.replace("TemplateName", "Loudness").replace("template_name", "loudness")
    path.write_text(text.replace("scale: float = 1.0", f"scale: float = {factor}"))
    return path


def recipe_file(folder: Path, text: str = RECIPE) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(text)
    return path


def local(folder: Path) -> Recipe:
    feature(folder)
    return load_recipe(recipe_file(folder))


def built(recipe: Recipe, corpus: Path, folder: Path, **options: Any) -> Path:
    build(recipe, corpus, folder / "out", cache=folder / "cache", **options)
    return folder / "out"


def values(path: Path) -> Any:
    with dancedata.open(path) as ds:
        return ds.read(ds.windows("train")[0], "loudness")


def computed(folder: Path) -> dict[str, int]:
    """Count the arrays in the cache."""
    return {stage.name: len(list(stage.rglob("*.npy"))) for stage in (folder / "cache").iterdir() if stage.is_dir()}


def test_the_hash_of_a_file_is_part_of_its_fields_only(tmp_path: Path) -> None:
    one = local(tmp_path)
    assert set(one.document["audio"]["loudness"]) == {"scale", "plugin_sha256"}
    assert "plugin_sha256" not in json.dumps(one.document["audio"]["librosa35"]) + json.dumps(one.document["motion"])
    assert parse_recipe(one.document).sha256 == one.sha256
    other = tmp_path / "elsewhere"
    other.mkdir()
    assert local(other).sha256 == one.sha256, "the folder does not matter"
    feature(tmp_path).write_text(feature(tmp_path).read_text() + "# changed\n")
    assert load_recipe(tmp_path / "recipe.yaml").sha256 != one.sha256
    without = RECIPE.replace("loudness: {}, ", "")
    named = load_recipe(recipe_file(tmp_path, without))
    plain = load_recipe(recipe_file(tmp_path, without.replace("plugins: [./loudness.py]", "")))
    assert named.sha256 == plain.sha256, "a file that is not used does not matter"


def test_processes_compute_with_a_file_and_a_change_computes_its_field_again(corpus: Path, tmp_path: Path) -> None:
    here = built(local(tmp_path), corpus, tmp_path, jobs=1)
    there = tmp_path / "there"
    there.mkdir()
    assert np.array_equal(values(built(local(there), corpus, there, jobs=2)), values(here))
    with dancedata.open(here) as ds:
        stated = ds.info["versions"]["plugins"]
    sha256 = load_recipe(tmp_path / "recipe.yaml").document["audio"]["loudness"]["plugin_sha256"]
    assert stated == {"audio loudness": {"file": "loudness.py", "sha256": sha256}}
    before = computed(tmp_path)
    path = feature(tmp_path)
    path.write_text(path.read_text().replace("self.scale * peaks", "2 * self.scale * peaks"))
    changed = load_recipe(tmp_path / "recipe.yaml")
    with pytest.raises(StoreError, match=r"audio\.loudness\.plugin_sha256"):
        built(changed, corpus, tmp_path)
    old = values(here)
    build(changed, corpus, tmp_path / "out", cache=tmp_path / "cache", jobs=2, overwrite=True)
    assert np.array_equal(values(here), 2 * old)
    after = computed(tmp_path)
    more = {stage: after[stage] - before[stage] for stage in after if after[stage] != before[stage]}
    songs = len(list((corpus / "wavs").iterdir()))
    assert len(more) == 1, more
    assert 0 < sum(more.values()) <= songs, "one array for each song that is used"


def test_a_dask_cluster_computes_with_a_file(corpus: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    recipe = local(tmp_path)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        path = built(recipe, corpus, tmp_path, backend="dask", scheduler=cluster.scheduler_address)
    assert values(path).shape[1] == 1


def test_workers_use_the_file_that_was_loaded(corpus: Path, tmp_path: Path) -> None:
    recipe = local(tmp_path)
    old = values(built(recipe, corpus, tmp_path, jobs=1))
    shutil.rmtree(tmp_path / "cache")
    path = tmp_path / "loudness.py"
    path.write_text(path.read_text().replace("self.scale * peaks", "2 * self.scale * peaks"))
    assert np.array_equal(values(built(recipe, corpus, tmp_path, jobs=2, overwrite=True)), old)


def test_reading_needs_the_file_that_the_dataset_was_built_with(corpus, tmp_path, monkeypatch):
    file = tmp_path / "my.py"
    file.write_text(REPRESENTATION)
    text = RECIPE.replace("./loudness.py", "my.py").replace("edge151", "my_motion").replace("loudness: {}, ", "")
    path = built(load_recipe(recipe_file(tmp_path, text)), corpus, tmp_path)
    names = dict(REGISTRIES["representations"]._classes)
    with dancedata.open(path) as ds:
        clip = ds.clips()[0].id
        assert ds[clip].motion("my_motion") is not None
        monkeypatch.setattr(
            REGISTRIES["representations"], "_classes", {k: v for k, v in names.items() if k != "my_motion"}
        )
        assert ds.read(ds.windows("train")[0], "my_motion").shape[1] == 151, "columns need no plug-in"
        with pytest.raises(UsageError, match=r"local plug-in, which is not loaded.*--plugin FILE"):
            ds[clip].motion("my_motion")
        file.write_text(REPRESENTATION.replace("My columns", "Changed"))
        dancedata.load_plugins(file)
        with pytest.raises(UsageError, match=r"not the one that the dataset was built with.*SHA-256"):
            ds[clip].motion("my_motion")
        file.write_text(REPRESENTATION)
        dancedata.load_plugins(str(file))
        assert ds[clip].motion("my_motion") is not None
        assert not [p for p in check(path) if p.severity == "error"]


def test_a_dataset_executes_nothing(tmp_path: Path) -> None:
    document = {**local(tmp_path).document, "plugins": [str(tmp_path / "bad.py")]}
    (tmp_path / "bad.py").write_text("raise SystemExit(1)")
    with raises_message(RecipeError, "plugins", where="recipe"):
        parse_recipe(document)


def test_two_files_with_one_name(tmp_path: Path) -> None:
    first, second = feature(tmp_path), feature(tmp_path, "2.0", "second.py")
    with raises_message(UsageError, "register"):
        dancedata.load_plugins(first, second)
    dancedata.load_plugins(first)
    assert FEATURES.get("loudness")().scale == 1.0  # type: ignore[attr-defined]
    dancedata.load_plugins(second)
    assert FEATURES.get("loudness")().scale == 2.0  # type: ignore[attr-defined]
    dancedata.load_plugins(first)
    assert FEATURES.get("loudness")().scale == 1.0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "content",
    [
        None, "", "1 / 0\n", "import nothing_of_this_name\n", FEATURE.replace("template_name", "librosa35"),
        "raise SystemExit(3)\n",
    ],
)  # fmt: skip
def test_files_that_cannot_be_loaded(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "file.py").write_text(content)
    with raises_message(UsageError, "plug-in|registered", where="file.py"):
        dancedata.load_plugins(tmp_path / "file.py")
    assert FEATURES.get("librosa35").__module__.startswith("dancedata.")


@pytest.mark.parametrize("value", ["./loudness.py", "[3]", "{a: b}"])
def test_plugins_is_a_list(value: str, tmp_path: Path) -> None:
    with raises_message(RecipeError, "plugins", where="recipe.yaml"):
        load_recipe(recipe_file(tmp_path, RECIPE.replace("[./loudness.py]", value)))


def test_the_option_of_commands(corpus: Path, tmp_path: Path) -> None:
    recipe = recipe_file(tmp_path, RECIPE.replace("plugins: [./loudness.py]", ""))
    plan = ["build", "--dry-run", str(recipe), str(corpus), "--cache", str(tmp_path / "cache"), "--json"]
    assert "unknown audio feature 'loudness'" in CliRunner().invoke(app, plan).output
    result = CliRunner().invoke(app, [*plan, "--plugin", str(feature(tmp_path))])
    assert json.loads(result.stdout)["result"]["recipe_sha256"] == local(tmp_path).sha256
