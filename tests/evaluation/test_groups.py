"""Protocols of groups: GCD's and Duolando's outputs, planted cases, files, datasets of groups, refusals."""

import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.evaluation.clips import store_clips
from dancedata.evaluation.protocol import protocol_named
from dancedata.scene.inputs.files import FileFormat, path_clips
from dancedata.store import Store
from dancedata.synthetic import synthesise_motion

Array = np.ndarray[Any, np.dtype[np.float64]]
GROUPS = ("-Ab_cdEf123_01_0_150", "plainid0123_03_0_152", "Zz9_8-7_6Q1_02_300_451")
FPS = 30


@pytest.fixture(scope="module")
def golden(crowd_golden: Any) -> Mapping[str, Array]:
    return crowd_golden("groups")


@pytest.fixture(scope="module")
def motions() -> dict[str, list[Motion]]:
    """Two duets and a trio of six seconds, dancers 1.5 m apart."""
    groups = {}
    for name, dancers in {"duet": (4, 5), "pair": (6, 7), "trio": (4, 6, 8)}.items():
        groups[name] = [
            Motion(m.translation[::2] + np.array([1.5 * k, 0, 0]), m.rotations[::2], FrameGrid.of(FPS), m.skeleton)
            for k, dancer in enumerate(dancers)
            for m in [synthesise_motion(f"gBR_sBM_cAll_d0{dancer}_mBR0_ch01", n_frames=360)[0]]
        ]
    return groups


def joints_of(groups: Mapping[str, list[Motion]]) -> dict[str, Array]:
    return {name: np.stack([motion.joints() for motion in group]) for name, group in groups.items()}


def assert_same_groups(folder: Path, groups: Mapping[str, Array]) -> None:
    """Evaluate files, and the same groups in memory."""
    options: dict[str, Any] = {"protocol": "groups", "fps": FPS, "intervals": False, "body": "smpl24"}
    found = dancedata.evaluate(folder, pool=groups, up="y", **options)
    expected = dancedata.evaluate(groups, pool=groups, **options)
    assert found.clips == tuple(groups)
    assert {s.name: s.value for s in found.scores} == {s.name: s.value for s in expected.scores}


def test_beats_are_a_mean_over_dancers(golden: Mapping[str, Array], shared: Path) -> None:
    scores = json.loads((shared / "golden" / "crowd" / "gcd" / "metrics.json").read_text())
    rows = {
        name: np.load(shared / "golden" / "crowd" / "inputs" / "gcd_librosa_features" / f"{name}.npy")
        for name in GROUPS
    }
    report = dancedata.evaluate(
        {name: golden[f"{name}.joints"] for name in GROUPS},
        protocol="gcd-groups", fps=FPS, body="smpl24", intervals=False, metrics=["bas"],
        music={name: np.flatnonzero(row[:, -1]) for name, row in rows.items()},
    )  # fmt: skip
    assert {row["clip"]: row["bas"] for row in report.per_clip} == pytest.approx(
        {name: scores[name]["beat_score"] for name in GROUPS}, rel=1e-5
    )


def test_results_of_gcd_in_their_files(golden: Mapping[str, Array], shared: Path) -> None:
    """Rotations and translations of all dancers in one pickle; joints are the stand-in's, on SMPL's male bones."""
    report = dancedata.evaluate(
        shared / "golden" / "crowd" / "inputs" / "gcd_results",
        protocol="gcd-groups", fps=FPS, up="y", unit="m", intervals=False, metrics=["gmc"],
    )  # fmt: skip
    assert {row["clip"]: row["gmc"] for row in report.per_clip} == pytest.approx(
        {name: float(golden[f"{name}.gmc"]) for name in GROUPS}, rel=1e-4
    )


def test_a_duet_as_duolando_scores_it(golden: Mapping[str, Array]) -> None:
    n = min(len(golden["follower"]), len(golden["leader"]))
    duet = {"Waltz_5_0": [golden["follower"], golden["leader"]]}
    report = dancedata.evaluate(duet, protocol="duolando", fps=FPS, intervals=False, metrics=["bed"])
    # The program takes the beats of the whole motion of both, a report those of the frames that both have.
    assert report["bed"].value == pytest.approx(float(golden["bed"]), rel=1e-9)
    assert report.per_clip[0]["frames"] == n
    assert any("shortest" in note for note in report.notes)


def test_planted_distances_collisions_and_contacts(motions: Mapping[str, list[Motion]]) -> None:
    first = motions["duet"][0].joints()
    through = np.stack([first, first + np.linspace(-3, 3, len(first))[:, None, None] * (1, 0, 0)])
    apart = np.stack([first, first + np.array([4, 0, 0]), first + np.array([0, 0, 3])])
    touching = np.stack([first, first + np.array([2.0, 0, 0])])
    touching[1, 30:75, 20] = touching[0, 30:75, 21]
    together = np.stack([first, first + np.array([2.0, 0, 0])])
    groups = {"together": together, "through": through, "apart": apart, "touching": touching}
    report = dancedata.evaluate(groups, protocol="groups", fps=FPS, body="smpl24", intervals=False)
    rows = {row["clip"]: row for row in report.per_clip if row["piece"] == 0}
    assert rows["apart"]["root_distance"] == pytest.approx((4 + 3 + 5) / 3)
    assert rows["apart"]["nearest_roots"] == pytest.approx(3)
    assert rows["apart"]["tif"] == rows["apart"]["touching"] == 0
    assert rows["through"]["tif"] == pytest.approx(2 * rows["through"]["colliding"])
    assert rows["through"]["colliding"] > 0
    assert rows["touching"]["touching"] == pytest.approx(45 / 150)
    assert rows["touching"]["contacts_per_minute"] == pytest.approx(60 / 5)
    assert rows["apart"]["bed"] == "no_duet"
    assert rows["together"]["bed"] == pytest.approx(1)
    assert rows["touching"]["bed"] < 1  # the wrist's jumps are beats


def test_files_of_groups_are_read_as_the_same_motions(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    expected = dancedata.evaluate(dict(motions), protocol="groups", intervals=False, pool=dict(motions))
    folder, masked = tmp_path / "results", tmp_path / "masked"
    folder.mkdir()
    masked.mkdir()
    for name, group in motions.items():
        rotations = np.stack([m.rotations for m in group]).reshape(len(group), -1, 72)
        content = {
            "transl": np.stack([m.translation for m in group]),
            "global_orient": rotations[..., :3], "body_pose": rotations[..., 3:],
        }  # fmt: skip
        (folder / f"{name}.pkl").write_bytes(pickle.dumps(content))
    for name, joints in joints_of(motions).items():
        padded = np.concatenate([joints, np.zeros_like(joints[:1])])
        np.savez(masked / f"{name}.npz", joints=padded, person_mask=[1] * len(joints) + [0])
    for path, given in ((folder, {"unit": "m"}), (masked, {"body": "smpl24"})):
        report = dancedata.evaluate(
            path, protocol="groups", fps=FPS, up="y", intervals=False, pool=dict(motions), **given
        )  # fmt: skip
        for score in expected.scores:
            if score.value is None:
                assert report[score.name].value is None, score.name
            else:
                assert report[score.name].value == pytest.approx(score.value, rel=1e-6, abs=1e-6), score.name


def test_a_dataset_of_duets(duets: Store) -> None:
    report = dancedata.evaluate(duets, split="all", protocol="groups", intervals=False)
    assert set(report.clips) == {clip.group for clip in duets.clips()}
    for name in ("gmc", "root_distance", "tif", "bed", "bas"):
        assert report[name].value is not None, name
    first = [group.clips[0] for group in store_clips(duets, protocol_named("groups"))[0]]
    assert first == [f"{name}_00" for name in report.clips]  # the follower
    by_hand = {}
    for name in report.clips:
        pair = sorted((c for c in duets.clips() if c.group == name), key=lambda c: c.role)
        assert [c.role for c in pair] == ["follower", "leader"]
        by_hand[name] = [dancedata.decode(c.read("edge151"), "edge151", fps=duets.fps) for c in pair]
    again = dancedata.evaluate(by_hand, protocol="groups", intervals=False, like=duets)
    for score in report.scores:
        assert again[score.name].value == pytest.approx(score.value, rel=1e-5, abs=1e-5), score.name


def test_refusals(store: Store, tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    with pytest.raises(UsageError, match="the dataset has none"):
        dancedata.evaluate(store, split="all", protocol="groups")
    with pytest.raises(UsageError, match="not a group"):
        dancedata.evaluate({"one": motions["duet"][0]}, protocol="groups")
    with pytest.raises(UsageError, match="an Evaluator single dancers"):
        dancedata.Evaluator(store, "edge151", protocol="groups", normalized=True)
    np.save(tmp_path / "one.npy", motions["duet"][0].joints())
    with pytest.raises(DataError, match="not of a group"):
        dancedata.evaluate(tmp_path, protocol="groups", fps=FPS, up="y")
    np.savez(tmp_path / "one.npz", joints=joints_of(motions)["duet"], person_mask=[1])
    (tmp_path / "one.npy").unlink()
    with pytest.raises(DataError, match="1 entries"):
        dancedata.evaluate(tmp_path, protocol="groups", fps=FPS, up="y")


def test_a_single_dancer_is_counted_as_undefined(motions: Mapping[str, list[Motion]]) -> None:
    groups = {"duet": motions["duet"], "one": motions["pair"][:1]}
    report = dancedata.evaluate(groups, protocol="groups", intervals=False, metrics=["gmc", "tif"])
    score = report["gmc"]
    assert all(name.startswith("one") for name in score.undefined["few_dancers"])
    assert score.value is not None


def test_files_of_dancers_are_one_group(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    """NAME_00 and NAME_01 are a duet, follower and leader, as in DD100."""
    joints = {name: group for name, group in joints_of(motions).items() if len(group) == 2}
    assert joints
    for name, duet in joints.items():
        for k, dancer in enumerate(duet):
            np.savez(tmp_path / f"{name}_{k:02}.npz", joints=dancer, fps=FPS)
    assert_same_groups(tmp_path, joints)
    first = next(iter(joints))
    (tmp_path / f"{first}_00.npz").rename(tmp_path / f"{first}_02.npz")
    with pytest.raises(UsageError, match="a dancer of a group is missing"):
        assert_same_groups(tmp_path, joints)


def test_dancers_that_decode_writes_are_one_group(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    """NAME_p0, NAME_p2: those who are there; of a batch NAME_000_p0 and so on. Twelve dancers are in order."""
    names = [f"crowd_p{2 * k}.npz" for k in range(12)]
    (tmp_path / "crowd").mkdir()
    for name in names:
        (tmp_path / "crowd" / name).touch()
    (crowd,) = path_clips(tmp_path / "crowd", FileFormat(groups=True))
    assert [path.name for path in (crowd.path, *crowd.partners)] == names
    groups = {f"{name}_{k:03}": group for k, (name, group) in enumerate(joints_of(motions).items())}
    for name, group in groups.items():
        for k, dancer in enumerate(group):
            np.savez(tmp_path / f"{name}_p{2 * k}.npz", joints=dancer, fps=FPS)
    assert_same_groups(tmp_path, groups)


def test_a_decoded_dancer_may_be_alone(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    group = next(iter(joints_of(motions).values()))
    np.savez(tmp_path / "alone_p0.npz", joints=group[0], fps=FPS)
    np.savez(tmp_path / "whole_p0.npz", joints=group, fps=FPS)
    report = dancedata.evaluate(
        tmp_path, protocol="groups", metrics=["collisions"], up="y", fps=FPS, intervals=False, body="smpl24"
    )
    assert report.clips == ("alone", "whole_p0")


def test_files_of_groups_may_be_numbered(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    """s_00, s_01 and s_02 that hold all their dancers are three groups, and not the dancers of one."""
    groups = {f"s_{k:02}": group for k, group in enumerate(joints_of(motions).values())}
    for name, group in groups.items():
        np.savez(tmp_path / f"{name}.npz", joints=group, fps=FPS)
    assert_same_groups(tmp_path, groups)
    np.savez(tmp_path / "s_01.npz", joints=groups["s_01"][0], fps=FPS)
    with pytest.raises(UsageError, match="hold whole groups"):
        assert_same_groups(tmp_path, groups)


def test_a_group_is_not_measured_as_a_dancer(tmp_path: Path, motions: Mapping[str, list[Motion]]) -> None:
    group = next(iter(joints_of(motions).values()))
    np.savez(tmp_path / "group.npz", joints=group, fps=FPS)
    with pytest.raises(DataError, match="protocol for groups"):
        dancedata.evaluate(tmp_path, protocol="dancedata", fps=FPS, up="y", intervals=False, metrics=["pfc"])
