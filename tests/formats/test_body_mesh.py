"""The mesh of a body model against the smplx library, as glTF and OBJ, and files that are refused."""

import json
import pickle
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.bodies import MOTORICA21, SMPLH52, SMPLX22, SMPLX52, SMPLX55
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.formats.body_mesh import BodyMesh, obj_text
from dancedata.formats.gltf import motion_glb
from dancedata.testing.examples import random_motion
from tests.body_models import body_model, body_model_arrays
from tests.messages import raises_message
from tests.video_files import smpl_pickle

N = 12
BETAS = np.linspace(-1, 1, 10)
BODIES = pytest.mark.parametrize("skeleton", [SMPL24, SMPLH52, SMPLX55], ids=lambda s: s.name)


def smplx_vertices(arrays: dict[str, Any], motion: Motion, betas: Any, *, correctives: bool = True) -> Any:
    """Return the vertices (T, V, 3) that the smplx library computes."""
    pytest.importorskip("smplx")
    torch = pytest.importorskip("torch")
    from smplx.lbs import lbs

    def tensor(array: Any) -> Any:
        return torch.tensor(np.asarray(array, dtype=np.float64))

    parents = arrays["kintree_table"][0].astype(np.int64)
    directions = arrays["posedirs"] * correctives
    vertices, _ = lbs(
        tensor(np.tile(betas, (motion.n_frames, 1))), tensor(motion.rotations.reshape(motion.n_frames, -1)),
        tensor(arrays["v_template"]), tensor(arrays["shapedirs"]),
        tensor(directions.reshape(-1, directions.shape[2]).T), tensor(arrays["J_regressor"]),
        torch.tensor(np.append(-1, parents[1:])), tensor(arrays["weights"]),
    )  # fmt: skip
    return vertices.numpy() + motion.translation[:, None]


@BODIES
def test_vertices_are_those_of_smplx(tmp_path: Path, skeleton: Skeleton) -> None:
    mesh = BodyMesh.read(body_model(tmp_path / "m.npz", skeleton), BETAS)
    motion = mesh.on(random_motion(skeleton, 70))  # in two parts
    wanted = smplx_vertices(body_model_arrays(skeleton), motion, BETAS)
    np.testing.assert_allclose(np.stack(list(mesh.posed(motion))), wanted, rtol=0, atol=2e-6)
    plain = smplx_vertices(body_model_arrays(skeleton), motion, BETAS, correctives=False)
    assert np.abs(plain - wanted).max() > 0.01


def test_smplx_reads_the_same_model_from_its_file(tmp_path: Path) -> None:
    """As published, of real size: the classes of smplx take vertices by number."""
    smplx, torch = pytest.importorskip("smplx"), pytest.importorskip("torch")
    few, n = body_model_arrays(SMPL24), 6890
    arrays = {k: few[k] for k in ("f", "kintree_table")}
    for name in ("v_template", "shapedirs", "posedirs", "weights"):
        arrays[name] = np.resize(few[name], (n, *few[name].shape[1:])).astype(np.float32)
    arrays["J_regressor"] = np.pad(few["J_regressor"], [(0, 0), (0, n - few["J_regressor"].shape[1])])
    path = tmp_path / "SMPL_NEUTRAL.pkl"
    path.write_bytes(smpl_pickle(arrays, ("shapedirs", "v_template", "weights", "posedirs")))
    plain = tmp_path / "plain" / "SMPL_NEUTRAL.pkl"
    plain.parent.mkdir()
    plain.write_bytes(pickle.dumps(arrays))
    mesh = BodyMesh.read(path, BETAS)
    motion = mesh.on(random_motion(SMPL24, 3))
    pose = torch.tensor(motion.rotations.reshape(3, 72), dtype=torch.float32)
    peer = smplx.SMPL(str(plain), batch_size=3)
    wanted = peer(
        betas=torch.tensor(np.tile(BETAS, (3, 1)), dtype=torch.float32), global_orient=pose[:, :3],
        body_pose=pose[:, 3:], transl=torch.tensor(motion.translation, dtype=torch.float32),
    ).vertices.detach().numpy()  # fmt: skip
    np.testing.assert_allclose(np.stack(list(mesh.posed(motion))), wanted, rtol=0, atol=5e-6)


def test_motions_of_other_joints_are_put_onto_the_model(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    meshes = {s.name: BodyMesh.read(body_model(tmp_path / f"{s.name}.npz", s)) for s in (SMPL24, SMPLH52, SMPLX55)}
    for skeleton, name in ((SMPLX52, "smplx55"), (SMPLX22, "smplh52"), (SMPLX22, "smplx55"), (SMPLX52, "smplh52")):
        motion = random_motion(skeleton, N)
        posed = meshes[name].on(motion)
        np.testing.assert_allclose(posed.joints()[:, 0], motion.joints()[:, 0], rtol=0, atol=1e-12)
        for j, joint in enumerate(skeleton.joints):
            np.testing.assert_array_equal(
                posed.rotations[:, posed.skeleton.index(joint)], motion.rotations[:, j], err_msg=joint
            )
        assert meshes[name].lost(motion) == ""
    fingers = "left_index1, left_index2, left_index3, left_middle1 and 26 more"
    lost = meshes["smpl24"].lost(random_motion(SMPLX52, N))
    assert lost == f"the body model has no {fingers}, which turn in the motion"
    with raises_message(UsageError, "motorica21"):
        meshes["smplx55"].on(random_motion(MOTORICA21, N))


@pytest.mark.parametrize(
    "changes",
    [
        {"posedirs": None, "f": None},
        {"posedirs": np.zeros((276, 3, 93))},  # STAR's
        {"weights": np.zeros((275, 24))},
        {"weights": np.full((276, 24), 1 / 23)},
        {"weights": np.full((276, 24), np.nan)},
        {"f": np.array([[0, 1, 276]])},
        {"f": np.array([[0, 1, 2.5]])},
        {"f": np.zeros((4, 4), int)},
        {"posedirs": np.full((276, 3, 207), np.inf)},
    ],
)
def test_meshes_that_contradict_themselves(tmp_path: Path, changes: dict[str, Any]) -> None:
    with raises_message(UsageError, "body_model", where="m.npz"):
        BodyMesh.read(body_model(tmp_path / "m.npz", SMPL24, **changes))


def test_a_model_is_one_file(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.npz"):
        with raises_message(UsageError, r"SMPL_MALE\.pkl"):
            BodyMesh.read(path)
    with raises_message(UsageError, "body_model", where="m.npz"):
        BodyMesh.read(body_model(tmp_path / "m.npz", SMPL24), np.ones(11))


class Read:
    """A .glb file, read by plain numpy."""

    def __init__(self, data: bytes) -> None:
        magic, version, size, length, kind = struct.unpack_from("<4s4I", data)
        assert (magic, version, size, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
        self.document = json.loads(data[20 : 20 + length])
        n_bytes, kind = struct.unpack_from("<2I", data, 20 + length)
        assert (kind, n_bytes) == (0x004E4942, self.document["buffers"][0]["byteLength"])
        self._numbers = data[28 + length :]
        assert len(self._numbers) == n_bytes
        assert length % 4 == n_bytes % 4 == 0
        self.nodes = self.document["nodes"]

    def array(self, number: int) -> Any:
        accessor = self.document["accessors"][number]
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        array = np.frombuffer(self._numbers, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        assert array.nbytes == view["byteLength"]
        for bound, of in (("min", array.min(axis=0)), ("max", array.max(axis=0))):
            assert np.array_equal(accessor.get(bound, of), of)
        return array

    @property
    def clock(self) -> Any:
        return self.array(self.document["animations"][0]["samplers"][0]["input"])[:, 0]

    def world(self, frame: int) -> Iterator[Any]:
        """Yield the matrices (4, 4) of the joints, in the order of the skin."""
        animation = self.document["animations"][0]
        local = {}
        for number, node in enumerate(self.nodes):
            local[number] = np.eye(4)
            local[number][:3, 3] = node.get("translation", (0, 0, 0))
        for channel in animation["channels"]:
            values = self.array(animation["samplers"][channel["sampler"]]["output"])
            node, path = channel["target"]["node"], channel["target"]["path"]
            if path == "translation":
                local[node][:3, 3] = values[frame]
            else:
                local[node][:3, :3] = Rotation.from_quat(values[frame]).as_matrix()
        parents = {child: n for n, node in enumerate(self.nodes) for child in node.get("children", ())}
        for joint in self.document["skins"][0]["joints"]:
            matrix, node = local[joint], joint
            while node in parents:
                node = parents[node]
                matrix = local[node] @ matrix
            yield matrix

    def vertices(self, frame: int) -> Any:
        attributes = self.document["meshes"][0]["primitives"][0]["attributes"]
        rest, joints, weights = (self.array(attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
        bind = self.array(self.document["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        moves = np.stack([world @ inverse for world, inverse in zip(self.world(frame), bind, strict=True)])
        mixed = np.einsum("vk,vkab->vab", weights, moves[joints])
        return np.einsum("vab,vb->va", mixed, np.pad(rest, [(0, 0), (0, 1)], constant_values=1))[:, :3]


@BODIES
def test_a_skinned_glb_moves_as_smplx_without_correctives(tmp_path: Path, skeleton: Skeleton) -> None:
    mesh = BodyMesh.read(body_model(tmp_path / "m.npz", skeleton), BETAS)
    motion = random_motion(skeleton, N, turn_rad=3.0)
    read = Read(motion_glb(motion, mesh))
    wanted = smplx_vertices(body_model_arrays(skeleton), mesh.on(motion), BETAS, correctives=False)
    for frame in range(N):
        np.testing.assert_allclose(read.vertices(frame), wanted[frame], rtol=0, atol=2e-6)
    np.testing.assert_allclose(read.clock, np.arange(N) / 30, rtol=1e-6)
    names = [read.nodes[joint]["name"] for joint in read.document["skins"][0]["joints"]]
    assert names == list(skeleton.joints)
    assert read.document["animations"][0]["extras"] == {"fps": "30", "frames": N}
    faces = read.array(read.document["meshes"][0]["primitives"][0]["indices"])
    np.testing.assert_array_equal(faces.reshape(-1, 3), body_model_arrays(skeleton)["f"])
    for sampler in read.document["animations"][0]["samplers"][1:]:
        turns = read.array(sampler["output"])
        assert (np.einsum("tk,tk->t", turns[1:], turns[:-1]) >= 0).all()


def test_more_than_four_weights_are_cut(tmp_path: Path) -> None:
    """Of seven joints; SMPL's own file has four. The bends of this motion are large."""
    arrays = body_model_arrays(SMPL24, influences=7)
    mesh = BodyMesh.read(body_model(tmp_path / "m.npz", SMPL24, weights=arrays["weights"]))
    motion = random_motion(SMPL24, N)
    read = Read(motion_glb(motion, mesh))
    wanted = smplx_vertices(arrays, mesh.on(motion), np.zeros(10), correctives=False)
    off = [np.linalg.norm(read.vertices(frame) - wanted[frame], axis=1) for frame in range(N)]
    assert 1e-4 < np.mean(off) < 0.01


def test_chunks_end_at_multiples_of_four(tmp_path: Path) -> None:
    faces = body_model_arrays(SMPL24)["f"][:-1]
    mesh = BodyMesh.read(body_model(tmp_path / "m.npz", SMPL24, f=faces))
    read = Read(motion_glb(random_motion(SMPL24, 3), mesh))
    np.testing.assert_array_equal(
        read.array(read.document["meshes"][0]["primitives"][0]["indices"]).reshape(-1, 3), faces
    )


def test_a_skeleton_alone(tmp_path: Path) -> None:
    motion = random_motion(MOTORICA21, N)
    still = replace(motion, rotations=motion.rotations * (np.arange(21) > 2)[:, None])
    read = Read(motion_glb(still))
    assert "meshes" not in read.document
    assert len(read.document["animations"][0]["channels"]) == 1 + 18  # joints that never turn have none
    for frame in (0, N - 1):
        places = np.stack(list(read.world(frame)))[:, :3, 3]
        np.testing.assert_allclose(places, still.joints()[frame], rtol=0, atol=1e-6)


def test_turns_do_not_depend_on_the_side_of_the_sphere() -> None:
    """Axis-angle beyond half a turn, and axes that flip there: linear between frames, as slerp of the rotations."""
    motion = random_motion(SMPL24, 4, turn_rad=0.1)
    spin = np.linspace(0, 12, 4)[:, None] * [0, 1, 0]
    motion = replace(motion, rotations=np.concatenate([spin[:, None], motion.rotations[:, 1:]], axis=1))
    read = Read(motion_glb(motion))
    turns = read.array(read.document["animations"][0]["samplers"][1]["output"])
    np.testing.assert_allclose(np.abs(np.einsum("tk,tk->t", turns, rotation(spin).as_quat())), 1, atol=1e-6)


def test_obj_has_the_vertices_and_triangles(tmp_path: Path) -> None:
    mesh = BodyMesh.read(body_model(tmp_path / "m.npz", SMPL24))
    lines = [line.split() for line in obj_text(mesh.vertices, mesh.faces).splitlines()]
    places = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    corners = np.array([line[1:] for line in lines if line[0] == "f"], dtype=int)
    assert len(places) + len(corners) == len(lines)
    np.testing.assert_allclose(places, mesh.vertices, rtol=0, atol=5.1e-7)
    np.testing.assert_array_equal(corners - 1, mesh.faces)
