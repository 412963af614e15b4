"""Samples, normaliser, features and scores of GCD's own code on made-up groups."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.contacts.velocity import Velocity
from dancedata.datasets.aioz_gdance import AiozGdance, load_dancers, read_sizes
from dancedata.metrics import beat_alignment, diversity, frechet, group_kinetic, motion_beats
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS, frame_features
from dancedata.metrics.set_statistics import STATISTICS
from dancedata.representations.gcd151 import SMPL24_GCD, Gcd151
from dancedata.torch import Dancers, GroupDataset
from tests.golden.conftest import Arrays, load

LENGTH, CONTACTS = 150, slice(147, 151)
ENDS = [0, 1, 148, 149]
GROUPS = ("-Ab_cdEf123_01_0_150", "plainid0123_03_0_152", "Zz9_8-7_6Q1_02_300_451")


@pytest.fixture(scope="module")
def facts(crowd: Path) -> Any:
    return json.loads((crowd / "gcd" / "facts.json").read_text())


@pytest.fixture(scope="module")
def whole(crowd: Path) -> Arrays:
    """GCD's columns of all dancers of each file, (P, T, 151)."""
    columns = {}
    for path in sorted((crowd / "inputs" / "aioz_gdance" / "motions_smpl").iterdir()):
        motions = load_dancers(path, range(read_sizes(path).dancers))
        columns[path.stem] = np.stack([Gcd151().encode(m, Velocity(max_speed_m_s=0.3)) for m in motions])
    return columns


@pytest.fixture(scope="module")
def groups(crowd: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, GroupDataset]:
    """Windows at every frame, by split, with the rows that stand in for Jukebox."""
    out = tmp_path_factory.mktemp("gcd") / "store"
    recipe = {
        "recipe": 1, "name": "gcd", "dataset": {"aioz-gdance": {"split": "by-video", "music": "optional"}},
        "windows": {"length_frames": LENGTH, "stride_frames": 1},
        "motion": {"gcd151": {"contacts": {"velocity": {"max_speed_m_s": 0.3}}}},
        "audio": {"file": {"path": "jukebox_features/{group}.npy", "rate": 30, "columns_per_row": 4}},
    }  # fmt: skip
    dancedata.build(recipe, crowd / "inputs" / "aioz_gdance", out, jobs=1, cache=cache, progress=False)
    splits = dancedata.open(out).splits
    return {split: GroupDataset(out, split, dancers=Dancers(persons=7), scale=None) for split in splits}


def sample(groups: Mapping[str, GroupDataset], name: str, start: int) -> dict[str, Any]:
    (found,) = [
        dataset[place]
        for dataset in groups.values()
        for place, window in enumerate(dataset.windows)
        if (window.clip.rsplit("_p", 1)[0], window.start) == (name, start)
    ]
    return found


def assert_contacts(facts: Any, name: str, persons: list[int], start: int, found: Any, wanted: Any) -> None:
    """Frames of a window before its last, which GCD takes as still."""
    near = {tuple(place) for place in facts["contacts_too_near_to_call"]}
    for row, k, column in np.argwhere(found[:, :3] != wanted[:, :3]):
        assert (name, persons[row], start + ENDS[k], column) in near
    assert (wanted[:, 3] == 1).all()


@pytest.mark.parametrize("number", [*range(10), 12, 13])
def test_samples(facts: Any, crowd: Path, groups: Mapping[str, GroupDataset], number: int) -> None:
    """The start and the members that GCD drew, read here: rows, masks and music."""
    row, golden = facts["samples"][number], load(crowd / "gcd" / "samples.npz")
    key, name, start = row["key"], row["seq"], row["fr_start"]
    ours = sample(groups, name, start)
    present = ours["person_mask"].numpy()
    persons = row["persons"] or list(range(int(present.sum())))
    rows = ours["gcd151"].numpy()[persons]
    assert len(persons) == row["eff_n_persons"]
    mask = np.arange(row["max_persons"]) < len(persons)
    np.testing.assert_array_equal(mask, golden[f"{key}.person_mask"])
    np.testing.assert_array_equal(row["person_mask"], mask)
    np.testing.assert_array_equal(golden[f"{key}.frame_mask"], np.ones(LENGTH))
    np.testing.assert_array_equal(golden[f"{key}.data_mask"], np.outer(mask, np.ones(LENGTH)))
    wanted = golden[f"{key}.first_last"]
    assert not wanted[len(persons) :].any()
    np.testing.assert_allclose(rows[:, ENDS, :147], wanted[: len(persons), :, :147], rtol=0, atol=1e-5)
    assert_contacts(facts, name, persons, start, rows[:, ENDS, CONTACTS], wanted[: len(persons), :, CONTACTS])
    if f"{key}.inp_rows_0_to_2" in golden:
        expected = golden[f"{key}.inp_rows_0_to_2"][..., :147]
        np.testing.assert_allclose(rows[:3, :, :147], expected, rtol=0, atol=1e-5)
    music = ours["file"].numpy()
    assert list(music.shape) == row["music_shape"]
    np.testing.assert_array_equal(music[[0, -1]], np.float32([row["music_first"], row["music_last"]]))


def test_lists(facts: Any, crowd: Path) -> None:
    """GCD filters its lists by the frames in a name; the reader has those with files."""
    scan = AiozGdance(split="official", music="optional").scan(crowd / "inputs" / "aioz_gdance")
    absent = {"plainid0123_09_0_200"}
    for key, wanted in facts["lists"].items():
        part, length = key.split(".")
        groups = {clip.group for clip in scan.clips if part == "all" or part in clip.lists}
        long = {name for name in groups if int(name.split("_")[-1]) - int(name.split("_")[-2]) >= int(length)}
        if part == "all":  # the official lists lack one
            absent = {"-Ab_cdEf123_05_10_170"}
        assert long == set(wanted) - absent, key


def test_bones_and_contact_rates(facts: Any, whole: Arrays) -> None:
    # The pelvis is put at the translation.
    np.testing.assert_allclose(SMPL24_GCD.offsets[1:], np.array(facts["skeleton_offsets"])[1:], atol=1e-7)
    for name, rate in facts["contact_rate"].items():
        near = sum(place[0] == name for place in facts["contacts_too_near_to_call"])
        assert abs(whole[name][..., CONTACTS].mean() - rate) * whole[name][..., CONTACTS].size <= near + 0.01, name


def test_normaliser(facts: Any, crowd: Path, whole: Arrays) -> None:
    """Mean and deviation (n - 1) of all frames of all dancers of the train list; absent dancers are 0 after it."""
    golden = load(crowd / "gcd" / "normalizer.npz")
    rows = np.concatenate([whole[name].reshape(-1, 151) for name in facts["lists"]["train.102"]]).astype(np.float64)
    assert len(rows) == facts["normalizer_rows"]
    mean, std = rows.mean(axis=0), rows.std(axis=0, ddof=1)
    np.testing.assert_allclose(mean, golden["mean"], rtol=0, atol=2e-5)
    np.testing.assert_allclose(std, golden["std"], rtol=0, atol=2e-5)
    assert float(golden["eps64"]) == 1e-10
    wanted = load(crowd / "gcd" / "samples.npz")["normalised.first_last"]
    varying = np.setdiff1d(np.arange(147), facts["std_zero_columns"])
    found = ((whole[GROUPS[0]] - mean) / (std + 1e-10))[..., varying]
    limit = 1e-4 + 4e-5 / std[varying]
    assert (np.abs(found[:, ENDS] - wanted[:2][..., varying]) < limit).all()
    assert np.abs(found).max() == pytest.approx(facts["normalised_abs_max_all_columns"], rel=1e-4)
    assert not wanted[2:].any()
    assert not wanted[..., [c for c in facts["std_zero_columns"] if c < 147]].any()


@pytest.mark.parametrize("name", GROUPS)
def test_kinetic_features_and_beats(crowd: Path, name: str) -> None:
    golden = load(crowd / "gcd" / "metrics.npz")
    joints = golden[f"{name}.joints"]
    for key, variant in (("kinetic72_gt", "gcd-fixed"), ("aist_kinetic72", "gcd-code")):
        found = [KINETIC_VARIANTS[variant](dancer, 30) for dancer in joints]
        np.testing.assert_allclose(found, golden[f"{name}.{key}"], rtol=1e-5, atol=1e-7, err_msg=key)
    np.testing.assert_allclose(group_kinetic(joints, 30), golden[f"{name}.group_kinetic72"], rtol=1e-5)
    for dancer, beats in zip(joints, golden[f"{name}.motion_beats"], strict=True):
        np.testing.assert_array_equal(motion_beats(dancer, 30, detector="gcd"), np.flatnonzero(beats))
    if f"{name}.kinetic72_per_frame" in golden:
        frames = np.log(1 + 1.5 * np.stack([frame_features(dancer, 30).reshape(-1, 72) for dancer in joints]))
        np.testing.assert_allclose(frames, golden[f"{name}.kinetic72_per_frame"], rtol=1e-5, atol=1e-6)


def test_frechet_distance_of_two_tables(crowd: Path) -> None:
    golden = load(crowd / "gcd" / "metrics.npz")
    wanted = json.loads((crowd / "gcd" / "metrics.json").read_text())["frechet_given"]
    real, made = STATISTICS["numpy"](golden["frechet_real"], golden["frechet_gen"])
    assert frechet(real, made) == pytest.approx(wanted["distance"], rel=1e-5)
    assert frechet(real, made) == pytest.approx(wanted["same_in_fid_script"], rel=1e-5)
    assert diversity(made) == pytest.approx(wanted["avg_pair_distance_gen"], rel=1e-5)


def test_alignment_cases(crowd: Path) -> None:
    """The mean over the beats of the motion; without them GCD's score is 0, which the protocol takes too."""
    for case in json.loads((crowd / "gcd" / "metrics.json").read_text())["alignment_score_sigma_2.12"]:
        if case["motion"]:
            score = beat_alignment(case["motion"], case["music"], sigma=2.12)
            assert score == pytest.approx(case["score"], rel=1e-6)
        else:
            assert case["score"] == 0
