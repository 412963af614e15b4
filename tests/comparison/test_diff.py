"""dancedata check A --same-as B: what differs is named, from the recipe down to the value."""

import json
from pathlib import Path
from typing import Any

import h5py
import pytest

from dancedata.comparison import Difference, diff, unmatched
from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash
from dancedata.files.regular_file import sha256_file
from tests.commands import as_json, run
from tests.messages import raises_message

TRAIN = "gHO_sBM_cAll_d19_mHO3_ch03"


def kinds(found: list[Difference]) -> set[str]:
    return {difference.kind for difference in found}


def of(found: list[Difference], kind: str) -> list[Difference]:
    return [difference for difference in found if difference.kind == kind]


def test_equal_datasets_have_no_difference(built_in: dict[str, Path], built_copy: Path):
    assert diff(built_in["track"], built_copy) == []
    assert run("check", built_in["track"], "--same-as", built_copy, code=0).stdout == "the same data\n"
    about = as_json("check", built_in["window"], "--same-as", built_in["window"])
    assert (about["same"], about["differences"]) == (True, [])
    with raises_message(StoreError, "finished"):
        diff(built_copy, built_copy.parent)
    run("check", built_copy, "--same-as", built_copy.parent, code=1)
    for atol in ("-1", "nan", "inf"):
        run("check", built_copy, "--same-as", built_copy, "--atol", atol, code=2)
    difference = Difference("clips", "7 clips only in A", tuple("abcdefg"))
    assert str(difference) == "clips: 7 clips only in A: a, b, c, d, e and 2 more"


def test_a_name_is_a_note(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["name=another"])
    found = diff(built, out)
    assert [str(d) for d in found] == ['note: name: "aist++", "another"']
    assert run("check", built, "--same-as", out, code=0).stdout.endswith("the same data\n")


def test_shards_cut_otherwise_hold_the_same_values(run_build: Any, built: Path, corpus: Path, out: Path):
    run_build(corpus, out, set=["store.shard_mb=1"])
    assert [str(d) for d in diff(built, out)] == ["recipe: store.shard_mb: 256, 1"]


@pytest.mark.parametrize(("scope", "name"), [("track", "aist++"), ("window", "aist++-edge-exact")])
def test_a_parameter_of_contacts_changes_four_columns(run_build, built_in, corpus, out, scope, name):
    key = "motion.edge151.contacts.velocity.max_speed_m_s"
    run_build(corpus, out, name, set=[f"{key}=1"])
    found = diff(built_in[scope], out)
    assert kinds(found) == {"recipe", "values"}
    assert str(of(found, "recipe")[0]).startswith(f"recipe: {key}: 0.3")
    (values,) = of(found, "values")
    assert values.message.startswith("edge151: other values in ")
    assert values.numbers == {"max_abs": 1.0}
    assert "contact" in values.message
    assert TRAIN in {name.partition("_slice")[0] for name in values.names}


def test_other_files_clips_and_rejects_are_named(run_build: Any, built: Path, source: Path, out: Path):
    (source / "motions" / f"{TRAIN}.pkl").write_bytes(b"")
    run_build(source, out)
    found = diff(built, out)
    assert kinds(found) >= {"source", "clips", "rejects"}
    assert of(found, "clips")[0].message == "1 clip only in A"
    assert of(found, "clips")[0].names == (TRAIN,)
    (reject,) = of(found, "rejects")
    assert (reject.message, reject.names) == ("1 line only in B", (TRAIN,))
    # The other way round.
    assert of(diff(out, built), "clips")[0].message == "1 clip only in B"


def test_windows_and_fields_are_named_and_the_command_ends_with_1(run_build, built, corpus, out):
    run_build(corpus, out, set=["windows.stride_s=1", "audio={}"])
    found = diff(built, out)
    assert kinds(found) >= {"recipe", "store", "fields", "windows"}
    assert of(found, "fields")[0].names == ("librosa35",)
    assert of(found, "windows")[0].message.startswith("windows of 4 clips: ")


def test_slices_and_other_rates_can_be_compared(run_build: Any, built_in: dict[str, Path], corpus: Path, out: Path):
    assert "clips" in kinds(diff(built_in["track"], built_in["window"]))
    run_build(corpus, out, set=["fps=60"])
    assert any("fps" in d.message for d in of(diff(built_in["track"], out), "store"))


def test_a_clips_metadata_are_compared(run_build: Any, built: Path, source: Path, out: Path):
    val = next(source.rglob("crossmodal_val.txt"))
    val.write_text(val.read_text() + f"{TRAIN}\n")
    train = next(source.rglob("crossmodal_train.txt"))
    train.write_text("".join(f"{line}\n" for line in train.read_text().split() if line != TRAIN))
    run_build(source, out)
    (clips,) = [d for d in of(diff(built, out), "clips") if d.message.startswith("split")]
    assert clips.message == "split of 1 clip, e.g. 'train', 'val'"
    assert clips.names == (TRAIN,)

    output = run("check", built, "--same-as", out, code=1).stdout
    assert output.splitlines()[-1].endswith(" differences")
    about = as_json("check", built, "--same-as", out, code=1)
    assert about["same"] is False
    assert {"kind", "message", "names", "numbers"} == set(about["differences"][0])


# A tolerance


def bend(out: Path, name: str, by: float, *, split: str = "train") -> None:
    """Change the first value of an HDF5 dataset, as another processor might, and dataset.json with it."""
    shard = next(out.glob("tables.h5" if name.startswith("clips/") else f"{split}-*-of-*.h5"))
    with h5py.File(shard, "r+", locking=False) as file:
        file[name][(0,) * file[name].ndim] += by
    document = json.loads((out / "dataset.json").read_text())
    for file, entry in [(entry["file"], entry) for entry in document["shards"]] + [*document["files"].items()]:
        entry["sha256"] = sha256_file(out / file)
    (out / "dataset.json").write_text(json.dumps({**document, "self_sha256": self_hash(document)}))


def test_values_within_a_tolerance_are_the_same(built: Path, built_copy: Path):
    bend(built_copy, "audio/librosa35", 2.0**-10)
    output = run("check", built, "--same-as", built_copy, "--atol", "0.001", code=0).stdout.splitlines()
    assert output[0] == "note: edge151: the same values"
    assert output[1].startswith("note: librosa35: other values in 2 of 4 clips, by at most 0.000977 (row 0 of ")
    assert ", column onset_envelope), within 0.001: " in output[1]
    assert output[2:] == ["the same data within 0.001"]
    about = as_json("check", built, "--same-as", built_copy, "--atol", "0.001")
    assert (about["same"], about["atol"]) == (True, 0.001)
    assert [d["numbers"]["max_abs"] for d in about["differences"]] == [0, pytest.approx(2.0**-10, rel=1e-3)]
    assert "values: librosa35: " in run("check", built, "--same-as", built_copy, "--atol", "0.0009", code=1).stdout
    assert "values: librosa35: " in run("check", built, "--same-as", built_copy, "--atol", "0", code=1).stdout
    assert run("check", built, "--same-as", built_copy, code=1).stdout.endswith("1 difference\n")


def test_numbers_about_clips_are_within_the_tolerance_and_counts_are_exact(built: Path, built_copy: Path):
    bend(built_copy, "clips/height_m", 1e-4)
    assert "height_m of 1 clip" in run("check", built, "--same-as", built_copy, code=1).stdout
    run("check", built, "--same-as", built_copy, "--atol", "0.001", code=0)
    bend(built_copy, "clips/n_frames", -1)
    assert "n_frames of 1 clip" in run("check", built, "--same-as", built_copy, "--atol", "100", code=1).stdout


def test_lines_match_if_their_numbers_are_within_the_tolerance():
    a, b = {"clip": "a", "frame": 3}, {"clip": "b"}
    one = [{**a, "value": 2.0}, {**a, "value": 1.0}, {**b, "numbers": {"std": 0.07, "n": 3}}]
    two = [{**a, "value": 1.0004}, {**a, "value": 2.5}, {**b, "numbers": {"std": 0.0701, "n": 4}}]
    assert unmatched(one, two, None) == (one, two)
    assert unmatched(one, two, 0.001) == ([one[0], one[2]], two[1:])
    assert unmatched(one, two, 1.0) == ([one[2]], [two[2]]), "a whole number is exact"
    assert unmatched(one, one[::-1], 0.0) == ([], [])
