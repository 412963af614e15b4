"""Small body models in the published layout: rings round the bones, with smooth shapes and pose correctives."""

from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.skeleton import Skeleton
from dancedata.formats.body_mesh import rest_joints

__all__ = ["body_model", "body_model_arrays"]

#: Vertices of a ring, and rings of a bone.
_RING, _RINGS = 4, 3


def body_model_arrays(skeleton: Skeleton, *, shapes: int = 10, influences: int = 4, seed: int = 0) -> dict[str, Any]:
    """Return the arrays of a model whose mean body has the bones of a skeleton.

    Parameters
    ----------
    influences
        Joints that move a vertex.
    """
    rng = np.random.default_rng(seed)
    rest, n = rest_joints(skeleton), skeleton.n_joints
    angles = np.arange(_RING) * 2 * np.pi / _RING
    shares = (np.arange(_RINGS) + 0.5) / _RINGS
    vertices, faces, near = [], [], []
    regressor = np.zeros((n, (n - 1) * _RINGS * _RING))
    for joint in range(1, n):
        parent = skeleton.parents[joint]
        bone = rest[joint] - rest[parent]
        side = np.cross(bone, (0.3, 0.5, 0.8))
        side /= np.linalg.norm(side)
        other = np.cross(bone, side) / np.linalg.norm(bone)
        radius = min(0.05, 0.3 * np.linalg.norm(bone))
        first = len(vertices)
        for share in shares:
            middle = rest[parent] + share * bone
            vertices += [middle + radius * (np.cos(a) * side + np.sin(a) * other) for a in angles]
            near += [share] * _RING
        for ring in range(_RINGS - 1):
            for k in range(_RING):
                a, b = first + ring * _RING + k, first + ring * _RING + (k + 1) % _RING
                faces += [[a, b, a + _RING], [b, b + _RING, a + _RING]]
        # The middles of the first and the last ring, extrapolated to the ends of the bone.
        begin, end = slice(first, first + _RING), slice(first + (_RINGS - 1) * _RING, first + _RINGS * _RING)
        step = (shares[-1] - shares[0]) / shares[0]
        regressor[joint, end], regressor[joint, begin] = (1 + 1 / step) / _RING, -1 / step / _RING
        if parent == 0 and not regressor[0].any():
            regressor[0, begin], regressor[0, end] = (1 + 1 / step) / _RING, -1 / step / _RING
    template = np.array(vertices)
    away = np.linalg.norm(template[:, None] - rest[None], axis=2)
    weights = np.exp(-away / 0.05)
    weights[np.argsort(np.argsort(away, axis=1), axis=1) >= influences] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    waves = np.sin(template @ rng.normal(0, 3, (3, 3 * shapes)) + rng.uniform(0, 6, 3 * shapes))
    tree = np.zeros((2, n), dtype=np.int64)
    tree[0], tree[1] = skeleton.parents, np.arange(n)
    return {
        "v_template": template,
        "shapedirs": 0.01 * waves.reshape(len(template), 3, shapes),
        "posedirs": rng.normal(0, 0.003, (len(template), 3, 9 * (n - 1))),
        "J_regressor": regressor,
        "weights": weights,
        "f": np.array(faces, dtype=np.uint32),
        "kintree_table": tree.astype(np.uint32),
    }


def body_model(path: Path, skeleton: Skeleton, **changes: Any) -> Path:
    """Write a small model as .npz; changes replace arrays, None removes one."""
    arrays = {**body_model_arrays(skeleton), **changes}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path
