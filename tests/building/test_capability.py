"""A thirteenth capability is one file beside the recipe, with copies at another speed, groups and two workers."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import ANY

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.building.fields.key_motion import KeyMotionField
from dancedata.building.fields.motion import RepresentationField, SceneField
from dancedata.building.plugins import Seen
from dancedata.building.result import Result, Rows
from dancedata.building.spine import expand
from dancedata.building.take import Take, Transform
from dancedata.cli.plugins import catalogue
from dancedata.core.clip import ClipRef
from dancedata.core.codebook import Codebook
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import RecipeError, StoreError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugin_files import FILE_KEY
from dancedata.core.registry import ANNOTATORS, DATASETS, FIELDS, REPRESENTATIONS, TRANSFORMS
from dancedata.recipes.parse import parse_recipe
from dancedata.store import Store, verify_store
from tests.messages import raises_message
from tests.takes import makers_of, take_of

LEAPS = Path(__file__).with_name("leaps.py")
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "leaps", "dataset": "aioz-gdance", "windows": {"length_s": 1, "stride_s": 0.5},
    "motion": "joints", "augment": {"mirror": True, "tempo": {"speeds": [1.25]}},
}  # fmt: skip
CAPABILITY = {
    "plugins": [str(LEAPS)], "transforms": ["moving-average"], "annotators": {"leaps": True},
    "fields": {"apart": {"fps": 10}},
    "rules": {"long-leaps": {"most_s": 0.2}},
}  # fmt: skip


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, Store]:
    """Built with the capability and without, by two workers."""
    folder = tmp_path_factory.mktemp("leaps")
    DATASETS.get("aioz-gdance")().make_example(folder / "source")
    stores = []
    for name, keys in (("with", CAPABILITY), ("without", {})):
        recipe = folder / f"{name}.yaml"
        recipe.write_text(yaml.safe_dump({**RECIPE, **keys}), encoding="utf-8")
        places = {"source": folder / "source", "out": folder / name, "cache": folder / "cache"}
        stores.append(dancedata.build(recipe, jobs=2, progress=False, **places).open())
    return stores[0], stores[1]


def test_motion_of_all_clips_and_copies_goes_through_the_transform(stores: tuple[Store, Store]) -> None:
    smoothed, plain = stores
    assert verify_store(smoothed.path) == []
    assert any(clip.group for clip in smoothed.clips())
    for clip in smoothed.clips():
        pelvis, before = (store[clip.id].read("joints")[:, :3] for store in stores)
        assert 0 < np.abs(np.diff(pelvis, n=2, axis=0)).sum() < np.abs(np.diff(before, n=2, axis=0)).sum()
    assert plain.info["recipe"]["transforms"] == []


def test_a_field_sees_all_dancers_of_clips_and_of_copies_at_their_speed(stores: tuple[Store, Store]) -> None:
    store, plain = stores
    assert store.info["recipe"]["fields"] == {"apart": {"fps": "10", "optional": False, FILE_KEY: ANY}}
    assert (store.field("apart").kind, "apart" in plain.fields) == ("motion", False)
    for clip in store:
        together = [c for c in store if c.group == clip.group and clip.group] or [clip]
        pelvis = np.stack([store[c.id].read("joints")[::3, :3] for c in together])
        rows, apart = clip.read("apart"), np.linalg.norm(pelvis - pelvis.mean(axis=0), axis=-1)
        assert rows.shape == (len(pelvis[0]), 1)
        np.testing.assert_allclose(rows[:, 0], apart[[c.id for c in together].index(clip.id)], atol=1e-4)
        assert (rows.max() > 1e-3) == (len(together) > 1)


def test_segments_of_copies_are_at_their_speed(stores: tuple[Store, Store]) -> None:
    store, _ = stores
    copied = [clip for clip in store if clip.id.endswith("__tempo")]
    marked = [clip for clip in copied if store.segments(clip.id, "leaps")]
    assert marked
    for clip in marked:
        of_copy, of_source = (store.segments(name, "leaps") for name in (clip.id, clip.source))
        assert len(of_copy) == len(of_source)
        assert [s.start for s in of_copy] == [s.start * 4 / 5 for s in of_source]


def test_windows_that_the_rule_names_are_left_out(stores: tuple[Store, Store]) -> None:
    store, plain = stores
    assert {r["reason"] for r in store.rejects} == {"filtered"} | {r["reason"] for r in plain.rejects}
    for clip in store:
        group = [c.id for c in store if c.group == clip.group and c.group] or [clip.id]
        long = [s for name in group for s in store.segments(name, "leaps") if s.value > 0.2]
        for window in plain[clip.id].windows():
            first, end = (store.grid.seconds(frame) for frame in (window.start, window.start + 30))
            touched = any(s.start < end and s.end > first for s in long)
            assert touched == (window.start not in [w.start for w in store[clip.id].windows()])


@pytest.mark.parametrize(
    ("fields", "word"),
    [({"apart": {"fps": "x"}}, "apart"), ({"apart": {"fps": 5000}}, "fps"), ({"apartt": {}}, "apart"),
     ({"apart": {"wide": 1}}, "optional"), (["apart"], "mapping")],
)  # fmt: skip
def test_a_field_that_is_wrong_is_a_problem_of_the_recipe(fields: Any, word: str) -> None:
    dancedata.load_plugins(LEAPS)
    with raises_message(RecipeError, word):
        parse_recipe({**RECIPE, "fields": fields})


class Plain(Transform):
    """Changes nothing."""

    name: ClassVar[str] = "plain"
    version: ClassVar[int] = 1


@dataclass(frozen=True)
class Twice(Plain):
    """Makes a copy of each clip."""

    mark: str

    def expand(self, take: Take) -> list[Take]:
        return [take, take.copy(self, lambda name: name + self.mark)]


def aistpp() -> tuple[Any, Take]:
    recipe = parse_recipe({**RECIPE, "dataset": "aist++", "augment": {}, "audio": {"librosa35": {}}})
    return recipe, take_of(recipe, [(ClipRef("a", Path("a.pkl"), Path("a.wav"), "train", "a"), "0" * 64)])


@pytest.mark.parametrize("transforms", [[Twice("_b"), Twice("_c")], [Twice("_b"), Plain()]])
def test_nothing_follows_the_step_that_copies(transforms: list[Transform]) -> None:
    _, take = aistpp()
    assert [t.dancers[0].id for t in expand([take], transforms[:1])] == ["a", "a_b"]
    with raises_message(UsageError, "last"):
        expand([take], transforms)


def _naming_a_file(named: Path) -> str:
    """Return the plug-ins, each with a parameter that names a file."""
    parameter = f'field(default=Path({str(named)!r}), metadata={{"path": True, "content": True}})'
    text = LEAPS.read_text().replace("import dataclass,", "import dataclass, field,")
    text = text.replace("ClassVar[int] = 1\n", f"ClassVar[int] = 1\n    file: Path = {parameter}\n")
    return text.replace("\nimport numpy", "\nfrom pathlib import Path\nimport numpy", 1)


@pytest.mark.parametrize("changed", ["plugin", "file"])
@pytest.mark.parametrize(
    ("registry", "name"), [(TRANSFORMS, "moving-average"), (ANNOTATORS, "leaps"), (FIELDS, "apart")]
)
def test_a_plugin_is_another_one_if_its_code_or_a_file_that_it_names_has_changed(tmp_path, registry, name, changed):
    """Transforms whatever their key."""
    named = tmp_path / "number.txt"
    text = _naming_a_file(named).replace(
        "    def scene(", "    def key(self):\n        return ['mine']\n\n    def scene(", 1
    )
    hashes = []
    for number in (1, 2, 2):
        file = tmp_path / "leaps.py"
        file.write_text(f"{text}# {number if changed == 'plugin' else 0}\n")
        named.write_text(str(number if changed == "file" else 0))
        dancedata.load_plugins(file)
        plugin = registry.make(name, {})
        hashes.append((plugin.on(FrameGrid.of(30)) if registry is FIELDS else plugin).sha256)
    assert hashes[0] != hashes[1] == hashes[2]
    assert str(named) in json.dumps(catalogue("plugins"))


def test_a_build_notices_that_a_file_of_a_transform_has_changed(tmp_path: Path) -> None:
    (tmp_path / "number.txt").write_text("1")
    (tmp_path / "leaps.py").write_text(_naming_a_file(tmp_path / "number.txt"))
    DATASETS.get("aioz-gdance")().make_example(tmp_path / "source")
    recipe = {**RECIPE, "plugins": [str(tmp_path / "leaps.py")], "transforms": ["moving-average"], "augment": {}}
    places = {"source": tmp_path / "source", "out": tmp_path / "out", "cache": tmp_path / "cache"}
    built = dancedata.build(recipe, progress=False, **places).open()
    (name,) = built.info["source"]["content"]
    dancedata.build(recipe, progress=False, **places)  # nothing to do
    (tmp_path / "number.txt").write_text("2")
    with raises_message(StoreError, f"different content: {name}", where=str(tmp_path / "out")):
        dancedata.build(recipe, progress=False, **places)


@pytest.mark.parametrize(
    ("plugin", "key", "where"),
    [("scene", "transforms", "01_0_180.pkl"), ("expand", "transforms", ""), ("judge", "rules", "clip ")],
)
def test_an_error_in_a_plugin_names_it_and_what_was_made(tmp_path: Path, plugin: str, key: str, where: str) -> None:
    (tmp_path / "none.py").write_text(
        "from dataclasses import dataclass\n"
        "from dancedata.building.plugins import WindowRule\n"
        "from dancedata.core.registry import RULES, TRANSFORMS\n"
        "from dancedata.building.take import Transform\n"
        f"@{key.upper()}.register('nothing')\n@dataclass(frozen=True)\n"
        f"class Nothing({'Transform' if key == 'transforms' else 'WindowRule'}):\n"
        f"    version = 1\n    def {plugin}(self, *_):\n        return None\n"
    )
    DATASETS.get("aioz-gdance")().make_example(tmp_path / "source")
    named: Any = {"nothing": {}} if key == "rules" else ["nothing"]
    recipe = {**RECIPE, "plugins": [str(tmp_path / "none.py")], key: named, "augment": {}}
    with pytest.raises((AttributeError, TypeError)) as error:
        dancedata.build(
            recipe, tmp_path / "source", tmp_path / "out", cache=tmp_path / "cache", progress=False, jobs=1
        )
    notes = "\n".join(error.value.__notes__)
    assert "nothing" in notes
    assert where in notes


def test_equal_plugins_of_two_kinds_have_results_of_their_own() -> None:
    plugin: Any = REPRESENTATIONS.make("joints", {})
    kinds = (RepresentationField, KeyMotionField)
    assert len({of_kind("joints", FrameGrid.of(30), plugin).sha256 for of_kind in kinds}) == 2


@dataclass(frozen=True, kw_only=True)
class Preset(SceneField):
    """Rows that are named, of real values or of codes."""

    name: ClassVar[str] = "preset"  # type: ignore[misc]
    version: ClassVar[int] = 1
    columns: ClassVar[Columns] = Columns((Group("x", 1, ""),))  # type: ignore[misc]
    preset: Any
    dtype: str = "float32"  # type: ignore[assignment]

    @property
    def codebook(self) -> Codebook | None:  # type: ignore[override]
        return Codebook("codes", (8,)) if self.dtype == "int16" else None

    def encode(self, motions: Any) -> Any:
        return self.preset


@pytest.mark.parametrize(
    ("dtype", "preset", "found"),
    [
        ("float32", [[[1]]], "1 arrays"),
        ("float32", None, "NoneType"),
        ("float32", [[[1j]]] * 2, "complex128"),
        ("int16", [[["a"]]] * 2, "<U1"),
        ("int16", [[[3.7]]] * 2, "3.7"),
        ("int16", [[[2**16 + 5]]] * 2, "65541"),
        ("int16", [[[3.0]]] * 2, ""),
        ("float32", [[[3]]] * 2, ""),
    ],
)
def test_rows_that_a_field_cannot_have_are_no_other_rows(dtype: str, preset: Any, found: str) -> None:
    field, motions = Preset(fps=30, preset=preset, dtype=dtype), [np.zeros(3)] * 2
    if found:
        with raises_message(UsageError, f"preset .*{found}"):
            field.encoded(motions, [0, 1], in_group=True)
    else:
        assert [(rows.dtype, rows.item()) for rows in field.encoded(motions, [0, 1], in_group=True)] == [
            (dtype, 3)
        ] * 2


@pytest.mark.parametrize("offset", [0, 3, -2])
def test_a_rule_sees_rows_from_frame_0_on(offset: int) -> None:
    recipe, take = aistpp()
    field = makers_of(recipe)["librosa35"]
    rows = np.arange(10 * 35, dtype=np.float32).reshape(10, 35)
    result = Result(take, (0,), (0,), made={field.id: [Rows(rows, "", offset)]})  # type: ignore[arg-type]
    seen = Seen(result, [field], recipe.grid, 30, [[]]).rows("librosa35", 0)  # type: ignore[list-item]
    assert len(seen) == 10 - offset
    np.testing.assert_array_equal(seen[max(0, -offset)], rows[max(0, offset)])
    assert np.isnan(seen[: max(0, -offset)]).all()
