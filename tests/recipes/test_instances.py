"""Several instances of one plug-in, PLUGIN.NAME, and audio fields with their own rate."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.building.build import build
from dancedata.building.plan import make_plan
from dancedata.core.errors import RecipeError, UsageError
from dancedata.execution.cache import Cache
from dancedata.files.regular_file import sha256_file
from dancedata.recipes.overrides import apply_override
from dancedata.recipes.parse import parse_recipe
from dancedata.recipes.recipe import Recipe
from tests.messages import raises_message


def recipe(*overrides: str, **changes: Any) -> Recipe:
    document: dict[str, Any] = {
        "recipe": 1,
        "name": "instances",
        "dataset": {"aist++": {}},
        "windows": {"length_s": 2, "stride_s": 0.5},
        "motion": {"edge151": {}, "edge151.strict": {"contacts": {"velocity": {"max_speed_m_s": 0.1}}}},
        "audio": {"librosa35": {}, "librosa35.60": {"fps": 60, "tightness": 50}},
        **changes,
    }
    for override in overrides:
        apply_override(document, override)
    return parse_recipe(document)


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


def test_a_dataset_with_instances_grows_from_the_cache(corpus: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    for out, made in (("one", recipe(audio={"librosa35": {}})), ("both", recipe()), ("fresh", recipe())):
        build(made, corpus, tmp_path / out, cache=cache if out != "fresh" else tmp_path / "other")
    for shard in (tmp_path / "both").glob("*.h5"):
        assert sha256_file(shard) == sha256_file(tmp_path / "fresh" / shard.name)
    assert Cache(cache).root.is_dir()


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


def test_a_plan_counts_rows_at_the_rate_of_the_field(corpus: Path, tmp_path: Path) -> None:
    sizes = {
        fps: make_plan(
            recipe("transforms=[{slices: {length_s: 2}}]", audio={"librosa35": {"fps": fps}}), corpus, cache=tmp_path
        ).to_json()
        for fps in (30, 60)
    }
    motion = make_plan(recipe("transforms=[{slices: {length_s: 2}}]", audio={}), corpus, cache=tmp_path).to_json()[
        "bytes"
    ]
    assert sizes[60]["bytes"] - motion == 2 * (sizes[30]["bytes"] - motion) > 0
