"""dancedata diff A B: what differs is named, from the recipe down to the value."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from dancedata.core.errors import StoreError
from dancedata.pipeline.diff import Difference, diff

TRAIN = "gHO_sBM_cAll_d19_mHO3_ch03"


def kinds(found: list[Difference]) -> set[str]:
    return {difference.kind for difference in found}


def of(found: list[Difference], kind: str) -> list[Difference]:
    return [difference for difference in found if difference.kind == kind]


def run(*args: object, code: int) -> str:
    from dancedata.cli import app

    result = CliRunner().invoke(app, ["diff", *map(str, args)])
    assert result.exit_code == code, result.output
    return result.stdout


def test_equal_datasets_have_no_difference(built_in: dict[str, Path], built_copy: Path):
    assert diff(built_in["track"], built_copy) == []
    assert run(built_in["track"], built_copy, code=0) == "the same data\n"
    about = json.loads(run(built_in["window"], built_in["window"], "--json", code=0))
    assert (about["same"], about["differences"]) == (True, [])


def test_a_name_is_a_note(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["name=another"])
    found = diff(built, out)
    assert [str(d) for d in found] == ['note: name: "aist++", "another"']
    assert run(built, out, code=0).endswith("the same data\n")


def test_shards_cut_otherwise_hold_the_same_values(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["store.shard_mb=1"])
    assert [str(d) for d in diff(built, out)] == ["recipe: store.shard_mb: 256, 1"]


@pytest.mark.parametrize(("scope", "name"), [("track", "aist++"), ("window", "aist++-edge-exact")])
def test_a_parameter_of_contacts_changes_four_columns(
    run_build: Any, built_in: dict[str, Path], corpus: Path, out: Path, scope: str, name: str
):
    key = "motion.edge151.contacts.velocity.max_speed_m_s"
    run_build(corpus, out, name, set=[f"{key}=1"])
    found = diff(built_in[scope], out)
    assert kinds(found) == {"recipe", "values"}
    assert str(of(found, "recipe")[0]).startswith(f"recipe: {key}: 0.3")
    (values,) = of(found, "values")
    assert values.message.startswith("edge151: other values in ")
    assert values.numbers == {"max_abs": 1.0}
    assert "contact" in values.message
    assert TRAIN in values.names


def test_other_files_clips_and_rejects_are_named(run_build: Any, built: Path, source: Path, out: Path):
    (source / "motions" / f"{TRAIN}.pkl").write_bytes(b"")
    run_build(source, out)
    found = diff(built, out)
    assert kinds(found) >= {"source", "clips", "rejects"}
    assert of(found, "clips")[0].message == "1 clips only in A"
    assert of(found, "clips")[0].names == (TRAIN,)
    (reject,) = of(found, "rejects")
    assert (reject.message, reject.names) == ("1 lines only in B", (TRAIN,))
    # The other way round.
    assert of(diff(out, built), "clips")[0].message == "1 clips only in B"


def test_windows_and_fields_are_named(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["windows.stride_s=1", "audio={}"])
    found = diff(built, out)
    assert kinds(found) >= {"recipe", "store", "fields", "windows"}
    assert of(found, "fields")[0].names == ("librosa35",)
    assert of(found, "windows")[0].message.startswith("windows of 4 clips: ")


def test_other_scopes_and_rates_can_be_compared(run_build: Any, built_in: dict[str, Path], corpus: Path, out: Path):
    assert "store" in kinds(diff(built_in["track"], built_in["window"]))
    run_build(corpus, out, set=["fps=60"])
    assert any("fps" in d.message for d in of(diff(built_in["track"], out), "store"))


def test_a_clips_metadata_are_compared(run_build: Any, built: Path, source: Path, out: Path):
    val = next(source.rglob("crossmodal_val.txt"))
    val.write_text(val.read_text() + f"{TRAIN}\n")
    train = next(source.rglob("crossmodal_train.txt"))
    train.write_text("".join(f"{line}\n" for line in train.read_text().split() if line != TRAIN))
    run_build(source, out)
    (clips,) = [d for d in of(diff(built, out), "clips") if d.message.startswith("split")]
    assert clips.message == "split of 1 clips, as 'train', 'val'"
    assert clips.names == (TRAIN,)


def test_the_command_ends_with_1_and_says_how_many(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["audio={}"])
    said = run(built, out, code=1)
    assert said.splitlines()[-1].endswith(" differences")
    about = json.loads(run(built, out, "--json", code=1))
    assert about["same"] is False
    assert {"kind", "message", "names", "numbers"} == set(about["differences"][0])


def test_long_lists_of_names_are_cut():
    difference = Difference("clips", "7 clips only in A", tuple("abcdefg"))
    assert str(difference) == "clips: 7 clips only in A: a, b, c, d, e and 2 more"
    assert len(difference.to_json()["names"]) == 7


def test_what_is_no_dataset_is_an_error(built: Path, tmp_path: Path):
    with pytest.raises(StoreError):
        diff(built, tmp_path)
    run(built, tmp_path, code=1)
