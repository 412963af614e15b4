"""Kinematics in torch: equal to numpy's, differentiable, in every precision."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from dancedata.core import motion as in_numpy
from dancedata.core.bodies import SKELETONS
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton
from dancedata.representations.joints import Joints
from dancedata.testing.examples import contact_rule_of
from dancedata.torch.kinematics import (
    decode,
    forward_kinematics,
    joints,
    matrix_from_6d,
    matrix_from_rotvec,
    rotvec_from_matrix,
)
from tests.messages import raises_message

WITH_ROTATIONS = [
    name
    for name in REPRESENTATIONS.names()
    if {"rotation_6d", "rotation_matrix"} & set(REPRESENTATIONS.get(name)().columns.names)
]
THIRTY = FrameGrid.of(30)
FRAMES = 12
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"))]
#: Lengths where axis-angle is delicate.
TURNS = (0.0, 1e-9, 1e-5, 1e-3, np.pi - 1e-6, np.pi, np.pi + 1e-6, 2 * np.pi, 3 * np.pi)
SIX_D = ("edge151", "finedance319", "lodge139", "lodge319")
#: Half the step from 1 to the next number in bfloat16.
BF16 = 2.0**-8


def random_motion(skeleton: Skeleton, seed: int = 0) -> Motion:
    """Any rotations at all, within 2 m of the origin."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(FRAMES, skeleton.n_joints, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    turns = rng.uniform(0, 4 * np.pi, axes.shape[:2])
    special = rng.random(turns.shape) < 0.3
    turns[special] = rng.choice(TURNS, special.sum())
    return Motion(rng.uniform(-2, 2, (FRAMES, 3)), axes * turns[..., None], THIRTY, skeleton)


def columns_of(name: str, seed: int = 0) -> np.ndarray:
    made = REPRESENTATIONS.get(name)()
    return made.encode(random_motion(made.skeleton, seed), contact_rule_of(made))


def batched(array: np.ndarray) -> torch.Tensor:
    """Rows (12, ...) as (3, 4, ...)."""
    return torch.from_numpy(array.copy()).reshape(3, FRAMES // 3, *array.shape[1:])


def flat(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().reshape(FRAMES, *tensor.shape[2:]).numpy()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", ["float32", "float64"])
@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_joints_of_every_skeleton(skeleton: Skeleton, kind: str, device: str) -> None:
    motion = random_motion(skeleton)
    wanted = in_numpy.forward_kinematics(skeleton, motion.rotations, motion.translation)
    turns, root = (batched(a).to(device, getattr(torch, kind)) for a in (motion.rotations, motion.translation))
    for rotations in (turns, batched(motion.matrices).to(device, getattr(torch, kind))):
        found = forward_kinematics(skeleton, rotations, root)
        assert found.dtype == getattr(torch, kind)
        assert found.shape == (3, 4, skeleton.n_joints, 3)
        np.testing.assert_allclose(flat(found), wanted, atol=1e-5 if kind == "float32" else 1e-12)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", WITH_ROTATIONS)
def test_decoding_every_representation(name: str, device: str) -> None:
    columns = columns_of(name)
    wanted = REPRESENTATIONS.get(name)().decode(columns, THIRTY)
    found = decode(batched(columns).to(device), name)
    assert found.skeleton is wanted.skeleton
    np.testing.assert_allclose(flat(found.translation), wanted.translation)
    np.testing.assert_allclose(flat(found.matrices), wanted.matrices, atol=3e-6)
    np.testing.assert_allclose(flat(found.joints()), wanted.joints(), atol=1e-5)
    np.testing.assert_allclose(flat(joints(batched(columns).to(device), name)), wanted.joints(), atol=1e-5)
    back = Rotation.from_rotvec(flat(found.rotations()).reshape(-1, 3).copy())
    angle = (back.inv() * Rotation.from_rotvec(wanted.rotations.reshape(-1, 3).copy())).magnitude()
    assert angle.max() < 2e-3  # float32 near half turns
    if found.contacts is not None:
        stored = columns[:, REPRESENTATIONS.get(name)().columns.slice("contact")]
        np.testing.assert_array_equal(flat(found.contacts), stored)


def test_positions_are_taken_as_they_are() -> None:
    motion = random_motion(SMPL24)
    for made in (REPRESENTATIONS.get("bailando72")(), Joints("smpl24")):
        found = joints(batched(made.encode(motion)), made)
        np.testing.assert_allclose(flat(found), motion.joints())
        with raises_message(UsageError, "bones"):
            joints(batched(made.encode(motion)), made, SMPL24_EDGE)
        with raises_message(UsageError, "consist"):
            decode(batched(made.encode(motion)), made)


@pytest.mark.parametrize("name", ["humanml263", "humanml264"])
def test_a_path_that_is_a_sum_of_steps(name: str) -> None:
    made, columns = REPRESENTATIONS.get(name)(), columns_of(name).astype(np.float64)
    for kind, tolerance in ((torch.float32, 1e-5), (torch.float64, 1e-10)):
        found = joints(torch.from_numpy(columns).to(kind), name)
        assert found.dtype == kind
        np.testing.assert_allclose(found, made.positions(columns), atol=tolerance)
    few = torch.from_numpy(columns[:4]).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: joints(x, name), few, fast_mode=True)


def test_ldas_ways_and_turns() -> None:
    made = REPRESENTATIONS.get("lda61")()
    columns = np.stack([columns_of("lda61", seed) for seed in (0, 1)])
    wanted = [made.decode(rows, THIRTY) for rows in columns]
    found = decode(torch.from_numpy(columns), "lda61")
    assert found.skeleton is made.skeleton
    np.testing.assert_allclose(found.translation, [m.translation for m in wanted], atol=1e-5)
    np.testing.assert_allclose(found.matrices, [m.matrices for m in wanted], atol=1e-5)
    np.testing.assert_allclose(joints(torch.from_numpy(columns), made), [m.joints() for m in wanted], atol=2e-5)
    few = torch.from_numpy(columns[:, :3].astype(np.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: joints(x, made), few, fast_mode=True)


def test_edges_root_is_another_skeleton() -> None:
    columns = columns_of("edge151")
    wanted = REPRESENTATIONS.get("edge151")().decode(columns, THIRTY).joints(SMPL24_EDGE)
    np.testing.assert_allclose(flat(joints(batched(columns), "edge151", SMPL24_EDGE)), wanted, atol=1e-5)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", SIX_D)
def test_bfloat16_loses_as_much_as_rounding_the_columns(name: str, device: str) -> None:
    """Within 1e-5 m of numpy on the same rounded numbers; within 3 cm of the motion, 2 m around the origin."""
    columns = columns_of(name)
    rounded = batched(columns).to(device, torch.bfloat16)
    made = REPRESENTATIONS.get(name)()
    found = joints(rounded, name)
    assert found.dtype == torch.float32
    exact = made.decode(flat(rounded.float()), THIRTY).joints()
    np.testing.assert_allclose(flat(found), exact, atol=1e-5)
    lost = np.abs(flat(found) - made.decode(columns, THIRTY).joints()).max()
    assert BF16 * 0.1 < lost < 0.03


@pytest.mark.parametrize("device", DEVICES)
def test_autocast_changes_nothing(device: str) -> None:
    columns = batched(columns_of("edge151")).to(device)
    wanted = joints(columns, "edge151")
    with torch.autocast(device, dtype=torch.bfloat16):
        found = joints(columns, "edge151")
        turned = decode(columns, "edge151").rotations()
    assert torch.equal(found, wanted)
    assert torch.equal(turned, decode(columns, "edge151").rotations())


def test_gradients_of_rotations() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(6, 3))
    vectors[0], vectors[1] = 0, 1e-5
    rotvec = torch.from_numpy(vectors).requires_grad_()
    root = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    small = Skeleton("six", tuple("abcdef"), (-1, 0, 1, 2, 1, 4), rng.normal(size=(6, 3)), (), (2, 3, 4, 5))
    assert torch.autograd.gradcheck(matrix_from_rotvec, rotvec)
    assert torch.autograd.gradcheck(lambda x: rotvec_from_matrix(matrix_from_rotvec(x)), rotvec)
    assert torch.autograd.gradcheck(lambda x, y: forward_kinematics(small, x, y), (rotvec, root))


def test_turns_there_and_back() -> None:
    rng = np.random.default_rng(2)
    axes = rng.normal(size=(len(TURNS) * 50, 3))
    vectors = axes / np.linalg.norm(axes, axis=-1, keepdims=True) * np.repeat(TURNS, 50)[:, None]
    matrices = matrix_from_rotvec(torch.from_numpy(vectors))
    np.testing.assert_allclose(matrices, Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14)
    back = rotvec_from_matrix(matrices).numpy()
    assert np.linalg.norm(back, axis=-1).max() <= np.pi + 1e-12
    np.testing.assert_allclose(Rotation.from_rotvec(back).as_matrix(), matrices, atol=1e-14)


def test_columns_that_are_not_rotations_stay_finite() -> None:
    """An untrained network may return anything: values and gradients have no NaN, and nothing is raised."""
    rows = torch.tensor([[0.0] * 6, [1, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [1e-20] * 6]).requires_grad_()
    matrices = matrix_from_6d(rows)
    matrices.sum().backward()
    assert torch.isfinite(matrices).all()
    assert torch.isfinite(rows.grad).all()


def test_wrong_shapes_are_named() -> None:
    with raises_message(UsageError, "decodes"):
        decode(torch.zeros(2, 150), "edge151")
    with raises_message(UsageError, "forward_kinematics"):
        forward_kinematics(SMPL24, torch.zeros(5, 22, 3), torch.zeros(5, 3))
    with raises_message(UsageError, "forward_kinematics"):
        forward_kinematics(SMPL24, torch.zeros(5, 24, 3), torch.zeros(4, 3))
    with raises_message(UsageError, "root_place"):
        joints(torch.zeros(2, 151), "edge152")
