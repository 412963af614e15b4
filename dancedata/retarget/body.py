"""A motion on any skeleton with a body -> SMPL's 24 joints, with that skeleton's own bones."""

from dataclasses import dataclass, replace

import numpy as np

from dancedata.core.bodies import has_body
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion, world_matrices
from dancedata.core.rest import LEGS, POINT, Aligner, anchor, body_size, missing_bone, norm, rest_positions
from dancedata.core.rotations import Float64Array, rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import SMPL24
from dancedata.retarget.maps import Names, map_skeleton

#: Frames that are inspected for the mean rotations of joints.
_SAMPLES = 300
_SMPL_LEGS = sum(norm(SMPL24.offsets[b]) for _, b in LEGS)


@dataclass(frozen=True, eq=False)
class Body:
    """A motion on SMPL's joints, before its bones change.

    `places`: Positions (T, K, 3) of the joints that the source has, metres.
    `joints`: (K,) their indices in the motion's skeleton.
    `unmapped`: Joints of the source that no joint of `motion` stands for.
    `missing`: Joints of `motion` that the source lacks.
    """

    motion: Motion
    places: Float64Array
    joints: tuple[int, ...]
    unmapped: tuple[str, ...]
    missing: tuple[str, ...]


def body_of(motion: Motion, names: Names | None = None) -> Body:
    """Put a motion on SMPL's joints; the world rotation of each joint is kept, up to one constant rotation."""
    source = motion.skeleton
    if has_body(source):
        return Body(motion, motion.joints(), tuple(range(source.n_joints)), (), ())
    of = map_skeleton(source, names)
    rest = rest_positions(source.parents, source.offsets)
    places = {j: rest[k] for j, k in of.items()}
    size = body_size(places)
    if (bone := missing_bone(places, size)) is not None:
        a, b = (SMPL24.joints[j] for j in bone[:2])
        raise UsageError(f"skeleton {source.name}: {a} and {b} are at the same position",
                         found=f"a distance of {bone[2]:.4g} m", allowed=f"more than {bone[3]:.4g} m")  # fmt: skip
    world = world_matrices(source, motion.matrices)
    step = -(-motion.n_frames // _SAMPLES)
    turns = {j: world[::step, k] for j, k in of.items()}
    aligner = Aligner(places, size * POINT, np.array([0.0, 1.0, 0.0]), turns, level=False)
    align = aligner.run()
    bones = np.zeros((24, 3))
    scale = sum(norm(places[b] - places[a]) for a, b in LEGS) / _SMPL_LEGS
    for j in range(1, 24):
        above = anchor(j, places)
        bones[j] = align[above].T @ (places[j] - places[above]) if j in of else 0.0
        if j not in of and j not in SMPL24.parents:
            bones[j] = SMPL24.offsets[j] * scale
    at = motion.joints()
    full = np.empty((motion.n_frames, 24, 3, 3))
    for j in range(24):
        if j not in of:
            full[:, j] = full[:, SMPL24.parents[j]]
            continue
        full[:, j] = world[:, of[j]] @ align[j]
        child = aligner.child_of.get(j)
        if child is not None and source.parents[of[child]] != of[j]:
            full[:, j] = shortest_rotation(full[:, j] @ bones[child], at[:, of[child]] - at[:, of[j]]) @ full[:, j]
    local = full.copy()
    for j in range(1, 24):
        local[:, j] = np.swapaxes(full[:, SMPL24.parents[j]], -1, -2) @ full[:, j]
    bones[0] = SMPL24.offsets[0]
    skeleton = replace(SMPL24, name=f"smpl24:{source.name}", offsets=bones, captured=True)
    moved = Motion(
        at[:, of[0]] - bones[0],
        rotvec_from_matrix(local),
        motion.grid,
        skeleton,
        motion.trim_start,
        motion.stretch_m,
        motion.fit_m,
    )
    unmapped = tuple(name for k, name in enumerate(source.joints) if k not in of.values())
    missing = tuple(name for j, name in enumerate(SMPL24.joints) if j not in of)
    return Body(moved, at[:, list(of.values())], tuple(of), unmapped, missing)
