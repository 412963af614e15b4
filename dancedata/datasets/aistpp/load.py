"""One AIST++ motion pickle -> canonical motion; each defect has a reason code."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, quoted
from dancedata.datasets.checks import (
    DOWNLOAD_AGAIN,
    bad_shape,
    lengths_differ,
    no_frames,
    require_finite,
    require_rotations,
)
from dancedata.formats.safe_pickle import load_pickle
from dancedata.formats.values import ValueArrays

KEYS = ("smpl_poses", "smpl_trans", "smpl_scaling")
JOINTS = 24
_CONVERT = "download the file again, or convert it"
_NOT_FINITE = "download the file again, or put the sequence on the ignore list"

Floats = NDArray[np.float64]


def load_motion(path: Path, frame_rate: int) -> Motion:
    """Read a pickle with ``smpl_poses``, ``smpl_trans`` and ``smpl_scaling``; other keys are not used.

    `path`: The pickle; read with the allow-list unpickler, so nothing in it is executed.
    `frame_rate`: Frames per second, 60 for AIST++.
    Returns: rotations (T, 24, 3) axis-angle in radians as in the file; translation (T, 3) in metres, ``smpl_trans /
        smpl_scaling`` in float64; +Y up; skeleton SMPL24.
    Raises DataError: reason ``broken_file``, ``unsafe_pickle``, ``missing_key``, ``bad_shape``, ``empty``,
        ``length_mismatch``, ``nan``, ``not_rotations`` or ``bad_scaling``.
    """
    arrays = _read(path)
    poses, trans = arrays.read("smpl_poses"), arrays.read("smpl_trans")
    if not (poses.shape[1:] == (JOINTS * 3,) or poses.shape[1:] == (JOINTS, 3)):
        raise bad_shape(path, "smpl_poses", poses.shape, "(N, 72) or (N, 24, 3)", _CONVERT)
    if trans.shape[1:] != (3,):
        raise bad_shape(path, "smpl_trans", trans.shape, "(N, 3)", _CONVERT)
    if len(poses) != len(trans):
        raise lengths_differ(path, "smpl_poses", len(poses), "smpl_trans", len(trans))
    if len(poses) == 0:
        raise no_frames(path)
    rotations = poses.reshape(len(poses), JOINTS, 3)
    require_finite(path, "smpl_poses", poses, _NOT_FINITE)
    require_finite(path, "smpl_trans", trans, _NOT_FINITE)
    require_rotations(path, "smpl_poses", rotations, trans, SMPL24.parents)
    return Motion(_in_metres(arrays, trans), rotations, FrameGrid.of(frame_rate), SMPL24)


def _read(path: Path) -> ValueArrays:
    """Return the arrays of the pickle, a dict with the three keys."""
    content = load_pickle(path)
    if not isinstance(content, Mapping):
        raise DataError("the pickle does not hold a dict", reason="broken_file", where=str(path),
                        found=f"{type(content).__name__}", allowed=f"a dict with {', '.join(KEYS)}",
                        fix=_CONVERT)  # fmt: skip
    missing = [key for key in KEYS if key not in content]
    if missing:
        raise DataError(f"the motion file has no {' and no '.join(missing)}", reason="missing_key", where=str(path),
                        found=f"keys {listed(content, show=quoted)}" if content else "no keys",
                        allowed=f"keys {', '.join(KEYS)}",
                        fix="download the file again; data in metres needs smpl_scaling = [1.0]")  # fmt: skip
    return ValueArrays(path, content)


def _in_metres(arrays: ValueArrays, trans: Floats) -> Floats:
    """Divide by the factor between the file's units and metres: 89 to 99 in AIST++, 1 for data in metres."""
    array = arrays.read("smpl_scaling")
    if array.size != 1:
        raise bad_shape(arrays.path, "smpl_scaling", array.shape, "one number, (1,)", _CONVERT)
    scaling = float(array.reshape(()))
    if np.isfinite(scaling) and scaling > 0:
        with np.errstate(over="ignore"):
            translation: Floats = trans / scaling
        if np.isfinite(translation).all():
            return translation
    raise DataError("smpl_scaling cannot turn smpl_trans into metres", reason="bad_scaling", where=str(arrays.path),
                    found=repr(scaling),
                    allowed="a finite number above 0 (about 89 to 99 in AIST++; 1 for data in metres)",
                    fix=DOWNLOAD_AGAIN)  # fmt: skip
