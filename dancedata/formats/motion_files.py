"""A motion as the bytes of one file, by the name of the format.

AMASS's and SMPL-X's arrays are in metres, +Z up. The pelvis keeps its position, so the translation differs by the
rest positions of the two bodies.
"""

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLH52, SMPLX55, transfer
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.skeleton import Skeleton
from dancedata.formats.bvh.write import motion_bvh
from dancedata.formats.gltf import motion_glb

Arrays = dict[str, npt.NDArray[Any]]

#: +Y up to +Z up: a quarter turn about x, (x, y, z) -> (x, -z, y).
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: Betas of the mean body; AMASS has 16.
_N_BETAS = 16


def amass_arrays(motion: Motion, gender: str = "neutral") -> Arrays:
    """Return AMASS's arrays on SMPL-H's 52 joints, such as poses (T, 156); UsageError for another family."""
    poses, trans = _upright(motion, SMPLH52)
    return {
        "trans": trans,
        "gender": np.array(gender),
        "mocap_framerate": np.array(float(motion.grid.rate)),
        "betas": np.zeros(_N_BETAS),
        "poses": poses.reshape(len(poses), -1),
    }


def smplx_arrays(motion: Motion, gender: str = "neutral") -> Arrays:
    """Return AMASS's SMPL-X arrays on 55 joints, such as poses (T, 165); UsageError for another family."""
    poses, trans = _upright(motion, SMPLX55)
    rows = poses.reshape(len(poses), -1)
    return {
        "gender": np.array(gender),
        "surface_model_type": np.array("smplx"),
        "mocap_frame_rate": np.array(float(motion.grid.rate)),
        "mocap_time_length": np.array(float(motion.grid.seconds(motion.n_frames))),
        "trans": trans,
        "poses": rows,
        "betas": np.zeros(_N_BETAS),
        "num_betas": np.array(_N_BETAS),
        "root_orient": rows[:, :3],
        "pose_body": rows[:, 3:66],
        "pose_jaw": rows[:, 66:69],
        "pose_eye": rows[:, 69:75],
        "pose_hand": rows[:, 75:165],
    }


def plain_arrays(motion: Motion) -> Arrays:
    """Return a motion as it is, +Y up: translation, rotations, joint positions, rate and skeleton."""
    skeleton = motion.skeleton
    return {
        "translation": motion.translation,
        "rotations": motion.rotations,
        "positions": motion.joints(),
        "fps": np.array(float(motion.grid.rate)),
        "fps_exact": np.array(str(motion.grid)),
        "skeleton": np.array(skeleton.name),
        "joints": np.array(skeleton.joints),
        "parents": np.array(skeleton.parents),
        "offsets": np.array(skeleton.offsets),
    }


def _upright(motion: Motion, body: Skeleton) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return rotations (T, J, 3) on a body and its translation, +Z up."""
    pelvis = motion.translation + motion.skeleton.offsets[0]
    moved = transfer(motion, body)
    rotations = np.array(moved.rotations)
    rotations[:, 0] = rotvec_from_matrix(_Z_UP @ matrix_from_rotvec(rotations[:, 0]))
    return rotations, pelvis @ _Z_UP.T - body.offsets[0]


def _npz(arrays: Callable[[Motion], Arrays]) -> Callable[[Motion], bytes]:
    def data(motion: Motion) -> bytes:
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays(motion))
        return buffer.getvalue()

    return data


#: Name -> suffix and what makes the bytes. bvh, glb: metres. smpl: AMASS's arrays on SMPL-H. smplx: on SMPL-X.
MOTION_FILES: Mapping[str, tuple[str, Callable[[Motion], bytes]]] = {
    "bvh": (".bvh", lambda motion: motion_bvh(motion).encode()),
    "npz": (".npz", _npz(plain_arrays)),
    "smpl": (".npz", _npz(amass_arrays)),
    "smplx": (".npz", _npz(smplx_arrays)),
    "glb": (".glb", motion_glb),
}


def motion_file(motion: Motion, kind: str) -> bytes:
    """Return the bytes of a file of the format `kind`, one of `MOTION_FILES`."""
    return MOTION_FILES[kind][1](motion)
