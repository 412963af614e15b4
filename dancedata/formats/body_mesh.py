"""The mesh of the user's body model, posed as the smplx library poses it, without that library and torch.

Vertices are those of Loper et al. 2015, eq. 2 to 9: the template with the betas' shape, plus the pose correctives
(posedirs times the elements of R - I of all joints except the root), skinned linearly with the file's weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer_to
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion, world_matrices
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed
from dancedata.formats.body_model import ModelArrays, not_a_model, shape_of, skeleton_of
from dancedata.formats.bvh.hierarchy import MAX_VALUE

Float32 = npt.NDArray[np.float32]
_Int32 = npt.NDArray[np.int32]

#: Joints that move a vertex in formats and shaders for skinned meshes.
INFLUENCES = 4
#: Most frames that are posed at a time: SMPL-X takes 126 kB each, and as much for its correctives.
_FRAMES = 64
#: How far the weights of a vertex may be from 1 in sum.
_WEIGHT_SUM = 1e-3


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """A body model with the shape of its betas.

    `skeleton`: Its J joints and bones, metres; the name states the model and the shape.
    `vertices`: (V, 3) at rest, metres.
    `faces`: (F, 3) vertices of the triangles, counterclockwise seen from outside.
    `weights`: (V, J) share of each joint in the place of a vertex.
    `correctives`: (V * 3, 9 * (J - 1)) change of the vertices with the elements of R - I.
    """

    skeleton: Skeleton
    vertices: Float32
    faces: _Int32
    weights: Float32
    correctives: Float32

    @classmethod
    def read(cls, path: str | Path, betas: npt.ArrayLike | None = None) -> BodyMesh:
        """Read a file of SMPL, SMPL-H or SMPL-X as published; nothing in it is executed. UsageError for any other."""
        file = Path(path).expanduser()
        if not file.is_file():
            problem = "a folder is not a body model" if file.is_dir() else "the body model does not exist"
            allowed = "one file, such as SMPLX_NEUTRAL.npz or SMPL_MALE.pkl"
            raise UsageError(problem, where=str(file), allowed=allowed, fix="name the file of the model")
        model = ModelArrays.read(file, ("f", "weights", "posedirs"))
        faces, weights, correctives = (model.more[name] for name in ("f", "weights", "posedirs"))
        _check(model, faces, weights, correctives)
        vertices = model.template + model.shapes @ shape_of(file, betas, model.shapes.shape[2])
        return cls(
            skeleton_of(model.regressor @ vertices, model.body, model.body),
            vertices.astype(np.float32),
            faces.astype(np.int32),
            (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
            correctives.astype(np.float32).reshape(vertices.size, -1),
        )

    def on(self, motion: Motion) -> Motion:
        """Put a motion on the model's joints by name, the pelvis where it is; UsageError for another family."""
        return transfer_to(motion, self.skeleton)

    def lost(self, motion: Motion) -> str:
        """Return a sentence on the joints that turn in a motion and that the model lacks; "" without any."""
        names = motion.skeleton.joints
        missing = [joint for joint, name in enumerate(names) if name not in self.skeleton.joints]
        lost = [names[joint] for joint in missing if motion.rotations[:, joint].any()]
        return f"the body model has no {listed(lost, 4)}, which turn in the motion" if lost else ""

    def posed(self, motion: Motion) -> Iterator[Float32]:
        """Yield the vertices (V, 3) of each frame of a motion on the model's bones (`on`), metres."""
        for begin in range(0, motion.n_frames, _FRAMES):
            part = motion.part(begin, min(begin + _FRAMES, motion.n_frames))
            local = part.matrices
            turns = (local[:, 1:] - np.eye(3)).reshape(part.n_frames, -1).astype(np.float32)
            shaped = self.vertices + (self.correctives @ turns.T).T.reshape(part.n_frames, -1, 3)
            for vertices, matrix, joints in zip(
                shaped, world_matrices(self.skeleton, local), part.joints(), strict=True
            ):
                yield skinned(vertices, self.weights, matrix, joints - np.einsum("jab,jb->ja", matrix, self.rest))

    @cached_property
    def rest(self) -> npt.NDArray[np.float64]:
        """Joints at rest, (J, 3) metres."""
        return rest_joints(self.skeleton)

    @cached_property
    def influences(self) -> tuple[npt.NDArray[np.uint8], Float32]:
        """The joints with the largest weights, (V, 4), largest first, and their weights (V, 4), 1 in sum."""
        order = np.argsort(-self.weights, axis=1, kind="stable")[:, :INFLUENCES]
        weights = np.take_along_axis(self.weights, order, axis=1)
        # Files for other programs state no joint of weight 0.
        joints = np.where(weights > 0, order, 0).astype(np.uint8)
        return joints, weights / weights.sum(axis=1, keepdims=True)

    @cached_property
    def sides(self) -> Float32:
        """How much of each vertex is of the trunk and head, the left and the right limbs, (V, 3), 1 in sum."""
        of_joint = np.zeros((self.skeleton.n_joints, 3), dtype=np.float32)
        for pair in self.skeleton.pairs:
            for side, joint in enumerate(pair, 1):
                of_joint[joint, side] = not self.skeleton.joints[joint].endswith(("_collar", "_eye"))
        of_joint[:, 0] = 1 - of_joint.sum(axis=1)
        return self.weights @ of_joint

    @cached_property
    def normals(self) -> Float32:
        """Unit normals of the vertices at rest, (V, 3)."""
        return vertex_normals(self.vertices, self.faces)


def rest_joints(skeleton: Skeleton) -> npt.NDArray[np.float64]:
    """Return the joints of a skeleton at rest, (J, 3) metres."""
    places = np.array(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents[1:], 1):
        places[joint] += places[parent]
    return places


def skinned(
    vertices: Float32, weights: Float32, turns: npt.NDArray[np.float64], moves: npt.NDArray[np.float64]
) -> Float32:
    """Return vertices (V, 3) moved by the joints' turns (J, 3, 3) and moves (J, 3), with weights (V, J)."""
    transforms = np.concatenate([turns.reshape(-1, 9), moves], axis=1).astype(np.float32)
    mixed = weights @ transforms
    moved: Float32 = np.einsum("vab,vb->va", mixed[:, :9].reshape(-1, 3, 3), vertices) + mixed[:, 9:]
    return moved


def vertex_normals(vertices: Float32, faces: _Int32) -> Float32:
    """Return unit normals (V, 3), the mean of the triangles' by area; (0, 1, 0) where there is no triangle."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(across[:, axis], 3), minlength=len(vertices)) for axis in range(3)],
        axis=1,
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), (0, 1, 0)).astype(np.float32)


def _check(
    model: ModelArrays,
    faces: npt.NDArray[np.float64],
    weights: npt.NDArray[np.float64],
    correctives: npt.NDArray[np.float64],
) -> None:
    vertices, joints = len(model.template), len(model.regressor)
    directions = 9 * (joints - 1)
    shapes = (faces.shape[1:], weights.shape, correctives.shape)
    if faces.ndim != 2 or shapes != ((3,), (vertices, joints), (vertices, 3, directions)):
        raise not_a_model(model.file, f"f {faces.shape}, weights {weights.shape}, posedirs {correctives.shape}",
                          f"(F, 3), ({vertices}, {joints}) and ({vertices}, 3, {directions}), "
                          f"for {vertices} vertices and {joints} joints")  # fmt: skip
    if not ((faces >= 0) & (faces < vertices) & (faces == np.floor(faces))).all():
        raise not_a_model(model.file, "triangles with vertices that do not exist", f"0 to {vertices - 1}")
    # NaN fails the comparisons as well.
    if not ((weights >= 0).all() and (np.abs(weights.sum(axis=1) - 1) <= _WEIGHT_SUM).all()):
        raise not_a_model(model.file, "weights of other sums than 1, or below 0", "shares of the joints")
    if not (np.abs(correctives) <= MAX_VALUE).all():
        raise not_a_model(model.file, "NaN, infinity or larger numbers", f"numbers within +-{MAX_VALUE:g}")


def obj_text(vertices: Float32, faces: _Int32) -> str:
    """Return a mesh as Wavefront OBJ, six decimals, with the vertices in their order; metres, +Y up."""
    places = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in vertices.tolist())
    return places + "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())
