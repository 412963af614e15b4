"""Retargeting: exact where the skeletons allow it, feet that stand, one world for a group."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dancedata.building.take import Scene
from dancedata.core.bodies import SMPLX22, SMPLX55
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, RecipeError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.formats.bvh.write import motion_bvh
from dancedata.recipes.parse import load_recipe
from dancedata.retarget.feet import contact_spans, sliding, with_planted_feet
from dancedata.retarget.maps import load_map, map_names, map_skeleton
from dancedata.retarget.transfer import leg_ratio, retargeted
from dancedata.retarget.transforms import Retarget
from dancedata.synthetic import synthesise_motion
from tests.messages import raises_message
from tests.retarget.test_limbs import CAPTURES

MM = 1e-3


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0]


def scene(motion: Motion, group: str = "") -> Scene:
    return Scene((motion,), (ClipRef("a", Path("a.bvh"), None, "train", "", group=group),), ((),))


def renamed(motion: Motion, family: str, scale: float) -> Motion:
    """The same dance on a scaled skeleton with a family's names, its rest pose turned joint by joint."""
    names = load_map(family)
    joints = tuple(f"rig:{names[j][0]}" if j in names else f"Extra{k}" for k, j in enumerate(SMPL24.joints))
    turns = np.tile(np.eye(3), (24, 1, 1))
    turns[[16, 18, 20, 22]] = rotation(np.array([0, 0, -0.8])).as_matrix()  # an A pose
    turns[[17, 19, 21, 23]] = rotation(np.array([0, 0, 0.8])).as_matrix()
    offsets = np.array(SMPL24.offsets) * scale
    offsets[1:] = np.einsum("jab,jb->ja", turns[list(SMPL24.parents[1:])], offsets[1:])
    local = motion.matrices.copy()
    for j in range(24):
        above = turns[SMPL24.parents[j]] if j else np.eye(3)
        local[:, j] = above @ local[:, j] @ turns[j].T
    rotations = rotvec_from_matrix(local)
    skeleton = Skeleton(family, joints, SMPL24.parents, offsets, SMPL24.pairs, SMPL24.feet)
    pelvis = (motion.translation + SMPL24.offsets[0]) * scale
    return Motion(pelvis - offsets[0], rotations, motion.grid, skeleton)


def scaled(motion: Motion, scale: float) -> Motion:
    skeleton = replace(SMPL24, name="scaled", offsets=SMPL24.offsets * scale)
    return Motion(motion.translation * scale, motion.rotations, motion.grid, skeleton)


def long_legged(motion: Motion) -> Motion:
    """Longer thighs, shorter shins, wider hips: positions cannot agree."""
    offsets = np.array(SMPL24.offsets)
    offsets[[4, 5]] *= 1.25
    offsets[[7, 8]] *= 0.9
    offsets[[1, 2], 0] *= 1.5
    return Motion(motion.translation, motion.rotations, motion.grid, replace(SMPL24, name="long", offsets=offsets))


def slid(feet: np.ndarray, spans: list[tuple[int, int]]) -> float:
    path, steps = sliding(feet, spans)
    return path / steps


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.3])
def test_a_scaled_body_is_exact(dance: Motion, scale: float) -> None:
    result = retargeted(scaled(dance, scale), SMPL24)
    assert np.abs(result.motion.joints() - dance.joints()).max() < MM
    assert result.residual_m.max() < MM
    assert result.scale == pytest.approx(1 / scale)
    assert result.flags() == []


@pytest.mark.parametrize("family", [name for name in map_names() if name != "smpl"])
def test_a_family_is_recognised_and_exact_in_its_limbs(dance: Motion, family: str) -> None:
    source = renamed(dance, family, 1.2)
    result = retargeted(source, SMPL24)
    # The skeleton has the joint that Motorica's map lacks, spine2.
    assert result.residual_m.max() < (0.02 if family == "motorica" else MM)
    of = map_skeleton(source.skeleton)
    assert {SMPL24.joints[j] for j in of} >= set(load_map(family)) - {"left_hand", "right_hand"}


@pytest.mark.parametrize(("prefix", "suffix"), [("Character1_", ""), ("rig", ""), ("", "_jnt"), ("a:b_", "")])
def test_joints_may_share_a_prefix_or_a_suffix(dance: Motion, prefix: str, suffix: str) -> None:
    source = renamed(dance, "mixamo", 1).skeleton
    joints = tuple(f"{prefix}{name.rpartition(':')[2]}{suffix}" for name in source.joints)
    assert map_skeleton(replace(source, joints=joints)) == map_skeleton(source)


def test_the_same_rest_pose_in_other_names_is_exact(dance: Motion) -> None:
    names = {joint: f"J_{k}" for k, joint in enumerate(SMPL24.joints)}
    skeleton = replace(SMPL24, name="own", joints=tuple(names.values()))
    result = retargeted(dance.on(skeleton), SMPL24, load_map(names))
    assert np.abs(result.motion.joints()[:, :22] - dance.joints()[:, :22]).max() < MM


def test_feet_do_not_slide_more_than_in_the_source(dance: Motion) -> None:
    target = long_legged(dance).skeleton
    toes = dance.joints()[:, 10:12]
    copied, kept = (retargeted(dance, target, feet=feet).motion.joints()[:, 10:12] for feet in (False, True))
    factor = leg_ratio(dance.skeleton, target)
    for side in (0, 1):
        spans = contact_spans(toes[:, side], 60)
        assert spans
        before, without, after = (slid(feet[:, side], spans) for feet in (toes * factor, copied, kept))
        assert after < before + 1e-4
        assert after < without / 2
        on_floor = np.concatenate([np.arange(*span) for span in spans])
        assert np.abs(kept[on_floor, side, 1] - factor * toes[on_floor, side, 1]).max() < 2 * MM


def test_feet_keep_their_rotation_and_bones_their_lengths(dance: Motion) -> None:
    from dancedata.core.motion import world_matrices

    source = long_legged(dance)
    moved = retargeted(source, SMPL24).motion
    own, other = (world_matrices(m.skeleton, m.matrices)[:, [7, 8]] for m in (source, moved))
    assert np.abs(own - other).max() < 1e-9
    joints = moved.joints()
    lengths = np.linalg.norm(joints[:, 4] - joints[:, 1], axis=1)
    assert np.ptp(lengths) < 1e-9


def standing(knee: np.ndarray) -> Motion:
    """A dancer on straight legs of 80 cm, the left knee bent by angles (T,), degrees; negative: backwards."""
    offsets = np.array(SMPL24.offsets)
    offsets[[4, 5, 7, 8]] = 0.0, -0.4, 0.0
    rotations = np.zeros((len(knee), 24, 3))
    rotations[:, 4, 0] = np.radians(knee)
    grid = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=2)[0].grid
    return Motion(np.zeros((len(knee), 3)), rotations, grid, replace(SMPL24, name="straight", offsets=offsets))


def lifted(motion: Motion, heights: np.ndarray, spans: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Joints before and after the left toe is planted `heights` (T,) above its place in the contacts."""
    toes = motion.joints()[:, 10:12].copy()
    toes[:, 0, 1] += heights
    return motion.joints(), with_planted_feet(motion, toes, [spans, []]).joints()


@pytest.mark.parametrize("mean", [0.0, 3.0, 40.0])
def test_a_straight_knee_is_bent_forwards_whatever_its_noise(mean: float) -> None:
    # A knee within a degree of straight has an axis of bending that noise turns around from frame to frame.
    knee = mean + np.random.default_rng(0).uniform(-1, 1, 60)
    before, after = lifted(standing(knee), np.full(60, 0.01), [(0, 60)])
    assert np.abs(after[:, 10, 1] - before[:, 10, 1] - 0.01).max() < 1e-9
    # By the law of cosines: the distance of the knee from the line from hip to ankle, legs of 0.4 and 0.4 m.
    reach = np.linalg.norm(after[:, 7] - after[:, 1], axis=1)
    line = (after[:, 7] - after[:, 1]) / reach[:, None]
    out = after[:, 4] - after[:, 1]
    out -= (out * line).sum(axis=1)[:, None] * line
    assert np.abs(np.linalg.norm(out, axis=1) - np.sqrt(0.16 - reach**2 / 4)).max() < 1e-9
    assert out[:, 2].min() > 0.05
    assert np.abs(np.diff(after[:, 4], axis=0)).max() < 0.015


def test_a_knee_that_is_bent_backwards_does_not_jump_where_a_correction_begins() -> None:
    knee = np.linspace(-8, 8, 120)
    before, after = lifted(standing(knee), np.full(120, 0.005), [(30, 90)])
    assert np.abs(before[:18] - after[:18]).max() < 1e-9
    bends = np.abs(np.diff(after[:, 4] - before[:, 4], axis=0)).max(axis=1)
    assert bends.max() < 0.01  # 4 cm where the axis is reversed
    assert np.abs(after[60:90, 10, 1] - before[60:90, 10, 1] - 0.005).max() < 1e-9


def test_corrections_pass_from_a_contact_to_the_next_without_a_step() -> None:
    heights = np.where(np.arange(100) < 43, 0.0, 0.03)
    before, after = lifted(standing(np.full(100, 30.0)), heights, [(10, 40), (46, 80)])
    moves = after[:, 10, 1] - before[:, 10, 1]
    assert np.abs(moves[10:40]).max() < 1e-9
    assert np.abs(moves[46:80] - 0.03).max() < 1e-9
    steps = np.diff(moves[39:47])
    assert steps.min() > 0
    # Of seven steps the first and the last are the smallest: with the mean of both corrections they were the largest.
    assert max(steps[0], steps[-1]) < 0.03 / 7


def test_a_group_keeps_its_distances(dance: Motion) -> None:
    other = Motion(dance.translation + np.array([1.5, 0.0, 0.4]), dance.rotations, dance.grid, dance.skeleton)
    dancers = [scaled(dance, 1.1), long_legged(other)]
    scale = 0.9
    results = [retargeted(m, SMPL24, scale=scale).motion for m in dancers]
    before = (dancers[1].joints()[:, 0] - dancers[0].joints()[:, 0])[:, ::2] * scale
    after = (results[1].joints()[:, 0] - results[0].joints()[:, 0])[:, ::2]
    assert np.abs(before - after).max() < 1e-9


def test_fingers_that_the_target_lacks_are_named(dance: Motion) -> None:
    source = Motion(dance.translation, np.zeros((240, 55, 3)), dance.grid, SMPLX55)
    notes = " ".join(retargeted(source, SMPLX22).notes)
    assert "left_index1" in notes
    assert "twists" in notes


def test_large_residuals_are_flagged_once_for_each_run(dance: Motion) -> None:
    result = retargeted(dance, SMPL24)
    residual = np.zeros(240)
    residual[[10, 11, 12, 50]] = 0.2, 0.4, 0.3, 0.5
    flags = replace(result, residual_m=residual).flags()
    assert {f.kind for f in flags} == {"retarget_residual"}
    assert [(f.frame, f.value) for f in flags] == [(11, 0.4), (50, 0.5)]


def test_a_map_may_come_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    for encoding in ("utf-8", "utf-8-sig"):  # as Notepad saves it
        path.write_text(json.dumps({"joints": {"pelvis": "Root", "left_hip": ["LThigh"]}}), encoding=encoding)
        assert load_map(path) == {"pelvis": ("Root",), "left_hip": ("LThigh",)}


def test_a_bad_map_and_one_that_nobody_knows_are_errors(tmp_path: Path) -> None:
    with raises_message(UsageError, "mixano"):
        load_map("mixano")
    for joints in ({"pelvsi": "Hips"}, {"pelvis": 3}, [], {}):
        (tmp_path / "own.json").write_text(json.dumps({"joints": joints}))
        with raises_message(UsageError, "joint"):
            load_map(tmp_path / "own.json")


def test_smpl_names_need_no_map(dance: Motion) -> None:
    plain, mapped = (retargeted(dance, SMPL24, names).motion for names in (None, load_map("mixamo")))
    assert np.array_equal(plain.rotations, mapped.rotations)


def test_a_skeleton_without_a_body_is_an_error(dance: Motion) -> None:
    skeleton = replace(SMPL24, name="robot", joints=tuple(f"J{k}" for k in range(24)))
    with raises_message(UsageError, r"retarget\.joint_map"):
        retargeted(dance.on(skeleton), SMPL24)
    with raises_message(DataError, "cannot be retargeted", reason="bad_skeleton"):
        Retarget().scene(scene(dance.on(skeleton)))


@pytest.mark.parametrize("joint", ["left_elbow", "right_wrist", "left_knee"])
def test_a_limb_without_length_is_an_error(dance: Motion, joint: str) -> None:
    source = renamed(dance, "mixamo", 1)
    offsets = np.array(source.skeleton.offsets)
    offsets[SMPL24.index(joint)] = 0
    with raises_message(UsageError, "same position"):
        retargeted(source.on(replace(source.skeleton, offsets=offsets)), SMPL24)


def test_a_target_of_another_family_is_an_error(dance: Motion) -> None:
    with raises_message(UsageError, "robot"):
        retargeted(dance, replace(SMPL24, name="robot", joints=tuple(f"J{k}" for k in range(24))))


_STAGES: dict[str, object] = {
    "text": "smpl24",
    "skeleton": {"skeleton": "smpl42"},
    "scale": {"skeleton": "smpl24", "scale": 0},
    "key": {"skeleton": "smpl24", "feets": True},
    "map": {"skeleton": "smpl24", "joint_map": "mixano"},
}


@pytest.mark.parametrize("value", _STAGES.values(), ids=_STAGES)
def test_a_bad_stage_is_a_problem_of_the_recipe(value: object) -> None:
    with raises_message(RecipeError, "problem", where="demo"):
        load_recipe("demo", {"transforms": [{"retarget": value}]})


def test_a_build_of_a_bvh_is_on_the_skeleton(dance: Motion, tmp_path: Path) -> None:
    import dancedata

    source = tmp_path / "source"
    source.mkdir()
    (source / "a.bvh").write_text(motion_bvh(long_legged(dance), "cm"))
    overrides = {
        "dataset": {"folder": {"unit": "cm", "music": "optional"}}, "audio": {}, "motion": {"joints": {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1}, "transforms.retarget.skeleton": "smpl24",
    }  # fmt: skip
    places = {"source": source, "out": tmp_path / "out", "cache": tmp_path / "cache"}
    built = dancedata.build("demo", overrides=overrides, jobs=1, progress=False, **places)
    assert any("retargeted to smpl24" in note for note in built.notes)
    with dancedata.open(built.path) as store:
        joints = store["a"].read("joints").reshape(-1, 24, 3)
    thighs = np.linalg.norm(joints[:, 4] - joints[:, 1], axis=1)
    assert np.abs(thighs - np.linalg.norm(SMPL24.offsets[4])).max() < 1e-4


def test_clips_of_a_group_have_one_scale(dance: Motion) -> None:
    source = scaled(dance, 1.1)
    alone, member = (Retarget().scene(scene(source, group)).motions[0].translation for group in ("", "duo"))
    path = np.linalg.norm(source.translation[-1, [0, 2]] - source.translation[0, [0, 2]])
    for translation, scale in ((alone, 1 / 1.1), (member, 1.0)):
        moved = np.linalg.norm(translation[-1, [0, 2]] - translation[0, [0, 2]])
        assert moved == pytest.approx(path * scale, rel=1e-3)


@pytest.mark.parametrize("name", ["Motorica", "CMU"])
def test_feet_of_real_captures_move_as_the_scaled_source(shared: Path, name: str) -> None:
    motion = load_motion(shared / str(CAPTURES[name][0]), Reading(Declared(), Declared(unit="guess"))).part(0, 600)
    result = retargeted(motion, SMPL24)
    feet, moved = motion.joints()[:, 10:12] * result.scale, result.motion.joints()[:, 10:12]
    for side in (0, 1):
        for span in contact_spans(feet[:, side] / result.scale, float(motion.grid.rate)):
            before, after = (sliding(toes[:, side], [span])[0] for toes in (feet, moved))
            assert after == pytest.approx(before, abs=MM)
    assert result.residual_m.max() < 0.3


@pytest.mark.parametrize(("capture", "up"), [("rokoko_jesse_dance", "y"), ("fair1_dab", "z"), ("cmu_01_01", "y")])
def test_legs_of_real_captures_do_not_jump_where_the_source_does_not(shared: Path, capture: str, up: str) -> None:
    reading = Reading(Declared(None, up), Declared(unit="guess"))
    motion = load_motion(shared / f"realdata/bvh/{capture}.bvh", reading)
    # CMU's first frame is a T pose, in which the source jumps as well.
    motion = motion.part(2, min(motion.n_frames, 1000))
    legs = [1, 2, 4, 5, 7, 8, 10, 11]
    result = retargeted(motion, SMPL24)
    before, after = (
        np.linalg.norm(np.diff(joints[:, legs], n=2, axis=0), axis=2).max()
        for joints in (motion.joints() * result.scale, result.motion.joints())
    )
    # Limbs of other proportions move a little faster: 1.09 times in FAIR's dab, 2.6 times while its knee jumped.
    assert after < 1.25 * before
