"""Recipes: what they say, what is wrong with them, what their hash depends on; several instances of a plug-in."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.building.build import build
from dancedata.core.errors import RecipeError, UsageError
from dancedata.core.registry import FEATURES, REPRESENTATIONS
from dancedata.files.yaml import load_yaml
from dancedata.recipes.overrides import apply_override
from dancedata.recipes.parse import load_recipe, parse_recipe, recipe_names
from dancedata.recipes.recipe import Recipe
from tests.messages import raises_message


def document(**changes: Any) -> dict[str, Any]:
    """A recipe in its shortest form; a change to None takes the key away."""
    short: dict[str, Any] = {
        "recipe": 1, "name": "mine", "dataset": "aist++", "windows": {"length_s": 5, "stride_s": 0.5},
        "motion": "edge151", "audio": "librosa35",
    }  # fmt: skip
    short.update(changes)
    return {k: v for k, v in short.items() if v is not None}


def problem_of(*, set: tuple[str, ...] = (), **changes: Any) -> str:
    """Return the message for a wrong recipe."""
    changed = document(**changes)
    for override in set:
        apply_override(changed, override)
    with raises_message(RecipeError, "length_frames|problem", where="mine.yaml") as caught:
        parse_recipe(changed, where="mine.yaml")
    return str(caught.value)


@pytest.mark.parametrize("name", recipe_names())
def test_every_recipe_that_comes_with_the_package_is_valid(name: str):
    assert load_recipe(name).name == name


def test_the_parts_of_a_recipe():
    recipe = parse_recipe(document(motion={"edge151": {"contacts": {"velocity": {"max_speed_m_s": 0.5}}}}))
    assert (recipe.fps, recipe.transforms) == (Fraction(30), ())
    assert (recipe.windows.length, recipe.windows.stride) == (150, 15)
    assert [(s.name, s.contacts.max_speed_m_s) for s in recipe.motion] == [("edge151", 0.5)]
    assert [f.name for f in recipe.audio] == ["librosa35"]
    assert parse_recipe(document()).motion[0].contacts.name == "velocity"
    assert parse_recipe(document(audio=None)).audio == ()


def test_all_problems_are_listed_at_once():
    text = problem_of(
        fsp=30,
        transforms={"slices": {}},
        dataset={"aist+": {}},
        motion={"edge115": {}},
        audio={"librosa35": {"tightnes": 1}},
        windows={"length_s": 5, "length_frames": 150, "stride_s": 0.5},
    )
    assert text.startswith("mine.yaml: 6 problems in the recipe")
    for part in ("fsp", "transforms", "'aist++'", "'edge151'", "'tightness'", "length_s and length_frames"):
        assert part in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"audio": {"librosa53": {}}}, "unknown audio feature 'librosa53'. Did you mean 'librosa35'?"),
        ({"dataset": None}, "dataset: name one dataset"),
        ({"motion": None}, "motion: name at least one representation"),
        ({"name": None}, "name: missing"),
        ({"recipe": 2}, "recipe: must be 1; found 2"),
        ({"fps": "thirty"}, "rate is not a number; found 'thirty'"),
        ({"fps": 1e9}, "fps is too high; found 1000000000; allowed: at most 1,000"),
        ({"windows": {"length_s": 5}}, "give one of stride_s and stride_frames; found neither"),
        ({"windows": {"length_s": 5.01, "stride_s": 0.5}}, "windows.length_s is not a whole number of frames"),
        ({"windows": {"length_s": 0, "stride_s": 0.5}}, "the length must be above 0"),
        ({"dataset": {"aist++": {"ignore": "some"}}}, "dataset.aist++"),
        (
            {"dataset": {"aist++": {}, "split": "all"}},
            "dataset.split: unknown key; did you mean 'dataset.aist++.split'?",
        ),
        ({"audio": {"librosa35.low": {"fps": 10}}}, "audio.librosa35.low: librosa35 cannot be computed"),
        ({"audio": {"librosa35": [1]}}, "audio.librosa35: parameters are a mapping of keys; found [1]"),
        ({"transforms": ["repair", {"repair": {}}]}, "transforms: a transform is named twice"),
        ({"transforms": [{"repair": {"gaps": "long"}}]}, "transforms.repair.gaps: must be true, false or a number"),
        ({"transforms": [{"retarget": {"scale": 0}}]}, "transforms.retarget.scale: must be auto or a number"),
        ({"annotators": ["facts"]}, "annotators: must be a mapping such as {facts: true}"),
        ({"annotators": {"faults": {}}}, "annotators.faults: its segments are not stored"),
        ({"rules": {"movement": {}}}, "rules.movement.field: no such field in motion or keymotion: lodge139"),
        ({"repair": {"gaps": True}}, "repair: unknown key; did you mean 'transforms.repair'?"),
    ],
)
def test_a_problem_says_what_is_wrong(changes: dict[str, Any], message: str):
    text = problem_of(**changes)
    assert message in text
    assert "1 problem in" in text


def test_windows_count_at_the_recipes_own_rate():
    frames = {"length_frames": 150, "stride_frames": 15}
    recipe = parse_recipe(document(fps="30000/1001", audio=None, windows=frames))
    assert recipe.document["fps"] == "30000/1001"
    assert "windows.length_s is not a whole number" in problem_of(fps="30000/1001", audio=None)
    unsupported = problem_of(fps="30000/1001", windows=frames)
    assert "librosa35 cannot be computed at this frame rate; found 30000/1001" in unsupported


def test_a_duplicate_key_is_an_error(tmp_path: Path):
    path = tmp_path / "twice.yaml"
    path.write_text("recipe: 1\nname: one\nname: two\n")
    with raises_message(RecipeError, "reading", where="twice.yaml"):
        load_recipe(path)


def test_an_invalid_yaml_file_is_named(tmp_path: Path):
    path = tmp_path / "bad.yaml"
    path.write_text("recipe: [1")
    with raises_message(RecipeError, "parsing", where="bad.yaml"):
        load_recipe(path)
    path.write_text("- recipe")
    with raises_message(RecipeError, "mapping", where="bad.yaml"):
        load_recipe(path)


def test_a_missing_recipe(tmp_path: Path):
    with raises_message(UsageError, "exist", where="none.yaml"):
        load_recipe(tmp_path / "none.yaml")
    with raises_message(UsageError, "aist[+][+]-60"):
        load_recipe("aist+")


def load(tmp_path: Path, *overrides: str, **changes: Any) -> Recipe:
    """Read a recipe from a file, with overrides; JSON is YAML."""
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps(document(**changes)))
    return load_recipe(path, overrides)


def test_overrides_reach_every_level(tmp_path: Path):
    recipe = load(
        tmp_path,
        "transforms.slices.stride_s=1",
        "windows.stride_s=1",
        "audio.librosa35.tightness=50",
        "dataset.aist++.split=all",
        "motion.edge151.contacts.velocity.max_speed_m_s=0.2",
    )
    assert (recipe.transforms[0].stride_s, recipe.windows.stride, recipe.dataset.split) == (1, 30, "all")
    assert recipe.audio[0].feature.tightness == 50
    assert recipe.motion[0].contacts.max_speed_m_s == 0.2


def test_overrides_reach_the_transforms_of_a_list(tmp_path: Path):
    chain = ["retarget", {"repair": {"spikes": True, "original": False}}]
    recipe = load(
        tmp_path, "transforms.repair.spikes=0.2", "transforms.retarget.feet=false",
        transforms=chain,
    )  # fmt: skip
    assert [step.name for step in recipe.transforms] == ["retarget", "repair"]
    retarget, repair = recipe.transforms
    assert (retarget.feet, repair.limits) == (False, {"spikes": 0.2})
    without = load(tmp_path, "transforms.repair=false", transforms=chain)
    assert [step.name for step in without.transforms] == ["retarget"]
    other_order = parse_recipe(document(transforms=[*reversed(chain)]))
    assert other_order.sha256 != parse_recipe(document(transforms=chain)).sha256


def test_the_motion_before_a_transform_that_keeps_it_is_a_field_of_its_own(tmp_path: Path):
    recipe = load(tmp_path, "transforms.repair.gaps=true", motion={"edge151": {}, "joints": {}})
    assert [field.name for field in recipe.motion] == ["edge151", "edge151.original", "joints", "joints.original"]
    assert [field.without for field in recipe.motion] == [(), ("repair",)] * 2
    assert {*recipe.document["motion"]} == {"edge151", "joints"}


def test_a_length_in_seconds_takes_the_place_of_one_in_frames_and_the_other_way_round(tmp_path: Path):
    frames = {"length_frames": 150, "stride_frames": 15}
    recipe = load(tmp_path, "windows.length_s=4", "windows.stride_s=1", windows=frames)
    assert (recipe.windows.length, recipe.windows.stride) == (120, 30)
    recipe = load(tmp_path, "windows.length_frames=60", "windows.stride_frames=6")
    assert (recipe.windows.length, recipe.windows.stride) == (60, 6)


@pytest.mark.parametrize("override", ["windows.stride_s", "=3", "windows..stride_s=1", "audio={"])
def test_an_invalid_override_is_wrong_usage(tmp_path: Path, override: str):
    with raises_message(UsageError, r"override|windows\.stride_s"):
        load(tmp_path, override)


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "another", "description": "Something else."},
        {"windows": {"stride_frames": 15, "length_frames": 150}},
        {"audio": {"librosa35": {"tightness": 100}}},
        {"audio": {"librosa35": {"tightness": 100.0}}},
        {"fps": "30", "transforms": [], "store": {"shard_mb": 256}},
        {"motion": {"edge151": {"contacts": {"velocity": {"max_speed_m_s": 0.3}}}}},
        {"dataset": {"aist++": {"music_dir": "elsewhere"}}},
    ],
)
def test_the_hash_does_not_depend_on_wording(changes: dict[str, Any]):
    backwards = dict(reversed(document(**changes).items()))
    assert parse_recipe(document(**changes)).sha256 == parse_recipe(backwards).sha256
    assert parse_recipe(backwards).sha256 == parse_recipe(document()).sha256


def test_neither_hash_nor_fields_depend_on_the_order_of_plugins(monkeypatch: pytest.MonkeyPatch):
    for registry, known, other in ((REPRESENTATIONS, "edge151", "another"), (FEATURES, "librosa35", "another")):
        cls = registry.get(known)
        monkeypatch.setitem(registry._classes, other, type("Another", (cls,), {"name": other}))
    one = parse_recipe(document(motion={"edge151": {}, "another": {}}, audio={"librosa35": {}, "another": {}}))
    two = parse_recipe(document(motion={"another": {}, "edge151": {}}, audio={"another": {}, "librosa35": {}}))
    assert one.sha256 == two.sha256
    assert [s.name for s in one.motion] == [s.name for s in two.motion]
    assert [f.name for f in one.audio] == [f.name for f in two.audio]


@pytest.mark.parametrize(
    "changes",
    [
        {"transforms": ["slices"]}, {"fps": 60}, {"audio": {"librosa35": {"tightness": 99}}}, {"audio": None},
        {"windows": {"length_s": 5, "stride_s": 1}}, {"dataset": {"aist++": {"split": "all"}}},
        {"store": {"shard_mb": 16}},
    ],
)  # fmt: skip
def test_the_hash_changes_with_the_settings_that_change_the_result(changes: dict[str, Any]):
    assert parse_recipe(document(**changes)).sha256 != parse_recipe(document()).sha256


def test_the_document_is_a_recipe_again():
    recipe = parse_recipe(document(description="About it."))
    again = parse_recipe(json.loads(json.dumps(recipe.document)))
    assert again.document == recipe.document
    assert again.sha256 == recipe.sha256


@pytest.mark.parametrize(
    ("text", "problem"),
    [("[" * 41 + "]" * 41, "deeper than 40"), (str(2**64), "more than 64 bits"),
     ("x" * (1 << 15) + "y", "at most 32,768")],
)  # fmt: skip
def test_the_limits_of_yaml(text: str, problem: str) -> None:
    with pytest.raises(yaml.YAMLError, match=problem):
        load_yaml(text)
    assert load_yaml(str(2**64 - 1)) == 2**64 - 1
    assert load_yaml("[" * 39 + "]" * 39)


def recipe(*overrides: str, **changes: Any) -> Recipe:
    """Instances of two plug-ins."""
    motion = {"edge151": {}, "edge151.strict": {"contacts": {"velocity": {"max_speed_m_s": 0.1}}}}
    audio = {"librosa35": {}, "librosa35.60": {"fps": 60, "tightness": 50}}
    made = document(windows={"length_s": 2, "stride_s": 0.5}, **{"motion": motion, "audio": audio, **changes})
    for override in overrides:
        apply_override(made, override)
    return parse_recipe(made)


def test_fields_documents_and_keys_carry_the_full_name() -> None:
    made = recipe()
    assert [field.name for field in made.fields] == ["edge151", "edge151.strict", "librosa35", "librosa35.60"]
    assert list(made.document["audio"]) == ["librosa35", "librosa35.60"]
    assert made.document["audio"]["librosa35.60"]["fps"] == "60"
    assert "fps" not in made.document["audio"]["librosa35"]
    assert parse_recipe(made.document).sha256 == made.sha256
    assert recipe(audio={"librosa35": {"fps": 30}}).sha256 == recipe(audio={"librosa35": {}}).sha256
    plain, other = (field.song_key(100.0, "song") for field in made.audio)
    assert plain != other
    alone = recipe(audio={"librosa35": {}}, motion={"edge151": {}})
    assert alone.audio[0].song_key(100.0, "song") == plain


@pytest.mark.parametrize("transforms", ["[]", "[{slices: {length_s: 2}}]"])
def test_instances_are_built_together(transforms, corpus, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = recipe(f"transforms={transforms}")
    build(made, corpus, tmp_path / "out", cache=tmp_path / "cache")
    with dancedata.open(tmp_path / "out") as ds:
        window = ds.windows("train")[1]
        rows = {name: ds.read(window, name) for name in ds.fields}
        assert {name: len(own) for name, own in rows.items()} == {
            "edge151": 60, "edge151.strict": 60, "librosa35": 60, "librosa35.60": 120,
        }  # fmt: skip
        # The first four columns are contacts: fewer where the limit on the speed is lower.
        assert rows["edge151.strict"][:, :4].sum() < rows["edge151"][:, :4].sum()
        np.testing.assert_array_equal(rows["edge151.strict"][:, 4:], rows["edge151"][:, 4:])
        clip = ds[window.clip]
        song = corpus / "wavs" / f"{clip.music}.wav"
        if transforms == "[]":
            whole = dancedata.features(song, "librosa35", fps=60, tightness=50, bpm=clip.tempo_bpm)
            first = window.start * 2
            np.testing.assert_array_equal(rows["librosa35.60"], whole[first : first + 120])


def test_set_takes_the_longest_key() -> None:
    made = recipe("audio.librosa35.60.tightness=70", "motion.edge151.strict.contacts.velocity.max_speed_m_s=0.4")
    assert [job.feature.tightness for job in made.audio] == [100, 70]
    assert [own.contacts.max_speed_m_s for own in made.motion] == [0.3, 0.4]
    assert recipe("audio.librosa35.tightness=70").audio[0].feature.tightness == 70


@pytest.mark.parametrize(
    "changes",
    [
        {"audio": {"librosa35.a b": {}}}, {"audio": {"librosa35.60": {"fsp": 60}}},
        {"audio": {"librosa35.60": {"fps": "fast"}}}, {"audio": {"librosa.60": {}}},
        {"audio": {"librosa35.60": {"fps": "1/7"}}}, {"audio": {35: {}}}, {"augment": "miror"},
        {"dataset": {"aist++.mine": {}}},
    ],
)  # fmt: skip
def test_bad_instances_are_named(changes: dict[str, Any]) -> None:
    with raises_message(RecipeError, r"librosa35\.60|problem", where="recipe"):
        recipe(**changes)


def test_a_song_gets_the_features_of_instances(corpus: Path, tmp_path: Path, run_build: Callable[..., Any]) -> None:
    from dancedata.songs import find_jobs, write_features

    build(recipe(), corpus, tmp_path / "out", cache=tmp_path / "cache")
    song = sorted((corpus / "wavs").glob("*.wav"))[0]
    about = write_features([song], tmp_path / "mine", find_jobs(None, str(tmp_path / "out")), 100.0)
    assert [a["file"] for a in about] == [f"{song.stem}.librosa35.npy", f"{song.stem}.librosa35.60.npy"]
    assert about[1]["shape"][0] in (2 * about[0]["shape"][0], 2 * about[0]["shape"][0] - 1)


def test_fields_of_files_are_not_computed_for_a_song(tmp_path: Path) -> None:
    from dancedata.songs import find_jobs

    of_files = '{path: "muq/{clip}.npy", rate: 25, fps: 25, columns_per_row: 8}'
    (tmp_path / "r.yaml").write_text(
        "recipe: 1\nname: r\ndataset: aist++\nwindows: {length_s: 2, stride_s: 2}\nmotion: {edge151: {}}\n"
        f"audio: {{librosa35: {{}}, file.muq: {of_files}}}\n"
    )
    with raises_message(UsageError, "librosa35"):
        find_jobs(None, str(tmp_path / "r.yaml"))
    assert [job.name for job in find_jobs("librosa35", str(tmp_path / "r.yaml"))] == ["librosa35"]
