"""edge151: EDGE's own numbers, exact decoding, mirroring."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import SMPLX52
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, forward_kinematics
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE
from dancedata.datasets.aistpp import AistPP
from dancedata.representations.edge151 import Edge151
from dancedata.store.normalize import MinMax
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
EDGE = Edge151()


def encode(motion: Motion) -> np.ndarray:
    return EDGE.encode(motion, Velocity())


def random_motion(seed: int, n: int = 5, size: float = 1.5) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(rng.normal(size=(n, 3)), rng.normal(size=(n, 24, 3)) * size, THIRTY, SMPL24)


@pytest.fixture(scope="module")
def clips(peers: Any) -> dict[str, Motion]:
    dataset = AistPP(ignore="none")
    return {ref.id: dataset.load(ref) for ref in dataset.scan(peers / "inputs" / "edge_aistpp").clips}


@pytest.mark.parametrize("split", ["train", "test"])
def test_edges_windows(peers: Any, clips: dict[str, Motion], split: str) -> None:
    names = json.loads((peers / f"edge_windows_{split}.json").read_text())
    golden = peers.load(f"edge_{split}.npz")
    assert len(names) == golden.shape("pose_raw")[0]
    made = []
    for name in names:
        clip, number = name.rsplit("_slice", 1)
        start = 30 * int(number)
        made.append(encode(clips[clip].part(start, start + 300).resampled(THIRTY)))
    found, wanted = golden.pair("pose_raw", np.stack(made))
    np.testing.assert_allclose(found[..., 4:], wanted[..., 4:], atol=1e-5)
    np.testing.assert_array_equal(np.stack(made)[..., :4], golden["contacts"])
    np.testing.assert_array_equal(np.stack(made)[:, -1, :4], 1)


def test_edges_normaliser(peers: Any) -> None:
    state, train, test = (peers.load(f"edge_{name}.npz") for name in ("normalizer", "train", "test"))
    if peers.whole:
        raw = train["pose_raw"].reshape(-1, 151)
        np.testing.assert_array_equal(raw.min(axis=0), state["data_min"])
        np.testing.assert_array_equal(raw.max(axis=0), state["data_max"])
    scaler = MinMax(state["data_min"], state["data_max"])
    np.testing.assert_allclose(scaler.scale, state["scale"], rtol=1e-6)
    np.testing.assert_allclose(scaler.offset, state["offset"], rtol=1e-5, atol=1e-5)
    both = np.intersect1d(test.index("pose_raw", 1), test.index("pose_normalized", 1))
    assert len(both) >= 4
    raw, wanted = (test[k][:, np.isin(test.index(k, 1), both)] for k in ("pose_raw", "pose_normalized"))
    np.testing.assert_allclose(scaler.normalize(raw, clip=True), wanted, atol=2e-5)


def test_columns() -> None:
    columns = EDGE.columns
    assert columns.width == 151
    assert columns.names == ("contact", "translation", "rotation_6d")
    assert columns.labels[:7] == (
        "contact.left_ankle", "contact.right_ankle", "contact.left_foot", "contact.right_foot",
        "translation.x", "translation.y", "translation.z",
    )  # fmt: skip
    assert columns.labels[7 + 6 * 4] == "rotation_6d.left_knee.0x"


def test_axes() -> None:
    """+Y up becomes +Z up: (x, y, z) -> (x, -z, y); the root turns by 90 degrees about x, the others do not."""
    row = encode(Motion(np.array([[1.0, 2, 3]]), np.zeros((1, 24, 3)), THIRTY, SMPL24))[0]
    assert row[4:7].tolist() == [1, -3, 2]
    np.testing.assert_allclose(row[7:13], [1, 0, 0, 0, 0, -1], atol=1e-7)
    np.testing.assert_allclose(row[13:], np.tile([1, 0, 0, 0, 1, 0], 23), atol=1e-7)


lengths = st.one_of(
    st.floats(0, 4 * np.pi), st.sampled_from([0.0, 1e-9, np.pi, 2 * np.pi, 3 * np.pi, 4 * np.pi]), st.floats(0, 1e-5)
)


@settings(max_examples=80, deadline=None)
@given(
    arrays(np.float64, (2, 24, 3), elements=st.floats(-1, 1)),
    arrays(np.float64, (2, 24, 1), elements=lengths),
    arrays(np.float64, (2, 3), elements=st.floats(-10, 10)),
)
def test_decoding_undoes_encoding(axes: np.ndarray, turns: np.ndarray, translation: np.ndarray) -> None:
    size = np.linalg.norm(axes, axis=-1, keepdims=True)
    axes = np.where(size > 1e-3, axes / np.maximum(size, 1e-3), [0.0, 0.0, 1.0])
    motion = Motion(translation, axes * turns, THIRTY, SMPL24)
    back = EDGE.decode(encode(motion), THIRTY)
    assert back.skeleton is SMPL24
    assert back.grid == THIRTY
    assert np.linalg.norm(back.rotations, axis=-1).max() <= np.pi + 1e-9
    a, b = (Rotation.from_rotvec(np.array(m.rotations)) for m in (motion, back))
    assert (a.inv() * b).magnitude().max() < 1e-4
    np.testing.assert_allclose(back.translation, translation, atol=1e-6 * 10)
    np.testing.assert_allclose(back.joints(), motion.joints(), atol=1e-4)
    np.testing.assert_allclose(encode(back)[:, 4:], encode(motion)[:, 4:], atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999))
def test_mirroring(seed: int) -> None:
    """Mirrored columns, danced by the mirrored body, are the reflection across x = 0."""
    mirror = EDGE.columns.mirror
    assert mirror is not None
    motion = random_motion(seed)
    array = encode(motion)
    np.testing.assert_array_equal(mirror.apply(mirror.apply(array)), array)
    image = EDGE.decode(mirror.apply(array), THIRTY)
    swap = list(range(24))
    for left, right in SMPL24.pairs:
        swap[left], swap[right] = right, left
    plain = forward_kinematics(SMPL24_EDGE, motion.rotations, motion.translation)
    mirrored = forward_kinematics(SMPL24_EDGE.mirrored(), image.rotations, image.translation)
    np.testing.assert_allclose(mirrored, plain[:, swap] * [-1, 1, 1], atol=1e-5)
    np.testing.assert_array_equal(mirror.apply(array)[:, :4], array[:, [1, 0, 3, 2]])


def test_contacts_are_those_of_the_rule() -> None:
    class Rule:
        def __call__(self, joints: np.ndarray, grid: FrameGrid, skeleton: object) -> np.ndarray:
            assert joints.shape == (5, 24, 3)
            assert grid == THIRTY
            return np.arange(20, dtype=np.float32).reshape(5, 4)

    array = EDGE.encode(random_motion(0), Rule())  # type: ignore[arg-type]
    np.testing.assert_array_equal(array[:, :4], np.arange(20).reshape(5, 4))
    with raises_message(UsageError, "contact"):
        EDGE.encode(random_motion(0))


def test_decoding_invalid_rotations() -> None:
    array = encode(random_motion(0))
    with raises_message(UsageError, "decodes"):
        EDGE.decode(array[:, :150], THIRTY)
    for columns, value, reason in (
        (slice(31, 37), 0, "bad_rotation"),
        (40, np.nan, "nan"),
        (40, np.inf, "nan"),
        (5, np.inf, "nan"),
    ):
        broken = array.copy()
        broken[3, columns] = value
        with raises_message(DataError, "infinity|plane", reason=reason) as error:
            EDGE.decode(broken, THIRTY)
        if reason == "bad_rotation":
            assert "frame 3, left_knee" in str(error.value)


def test_generated_rows_need_not_be_orthonormal() -> None:
    array = encode(random_motion(1))
    noisy = array + np.random.default_rng(0).normal(size=array.shape).astype(np.float32) * 0.05
    matrices = Rotation.from_rotvec(np.array(EDGE.decode(noisy, THIRTY).rotations)).as_matrix()
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-9)


def test_the_whole_smpl_family_can_be_encoded() -> None:
    """Rotations go by name: fingers are left out, SMPL's hands, which SMPL-X lacks, do not turn."""
    rng = np.random.default_rng(4)
    motion = Motion(rng.normal(size=(3, 3)), rng.normal(size=(3, 52, 3)), THIRTY, SMPLX52)
    hands = np.zeros((3, 2, 3))
    pelvis = motion.translation + SMPLX52.offsets[0]  # which stays where it is
    same = Motion(
        pelvis - SMPL24.offsets[0], np.concatenate([motion.rotations[:, :22], hands], axis=1), THIRTY, SMPL24
    )
    np.testing.assert_array_equal(encode(motion)[:, 7:], encode(same)[:, 7:])
    np.testing.assert_allclose(encode(motion), encode(same), atol=1e-6)


def test_other_skeletons_are_refused() -> None:
    other = replace(SMPL24, name="other", joints=("hips", *SMPL24.joints[1:]))
    with raises_message(UsageError, "smpl24"):
        encode(Motion(np.zeros((1, 3)), np.zeros((1, 24, 3)), THIRTY, other))
