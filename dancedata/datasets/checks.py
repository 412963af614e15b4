"""Checks of what motion files hold: arrays, rotations, the axis that is up; and the errors about them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import BODY_JOINTS, SMPLX52, SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_6d, matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.sides import wrong_up
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, quoted
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.stated import UPRIGHT

DOWNLOAD_AGAIN = "download the file again"
#: Bound of the deviation of published matrices from rotations.
_TOLERANCE_MATRIX = 1e-3
#: Least cosine between the mean vector from pelvis to head and the axis that is taken as up.
_UPRIGHT_COSINE = 0.8
#: Part of every message about an array that may contain positions.
POSITIONS = (
    "joint positions are not rotations: save them as positions, numpy.savez(file, positions=(T, J, 3), "
    "joint_names=[...]), to which rotations are fitted; or export BVH, or fit SMPL with another tool"
)
#: Largest number of frames that are examined.
_MAX_FRAMES = 300
_LEAST_FRAMES = 10
#: A bone counts as moving if its vector moves by more than this fraction of its length; least number of such bones.
_MOVES, _LEAST_BONES = 0.05, 6
#: Thresholds of the median over bones of (change of length) / (change of vector): 0.44 to 0.72 for rotation vectors
#: of real dances, for random ones at least 0.18 from ten frames on and 0.33 from sixty on, 0 for positions of a body
#: with rigid bones, 0.11 to 0.24 for positions of real dances with 1 cm of noise in each coordinate.
_MANY_FRAMES, _RIGID, _RIGID_OF_FEW_FRAMES = 60, 0.25, 0.1
#: Bound of the median length of the rotation vectors of a body; at most 0.44 rad in real dances.
_LONGEST_MEDIAN = np.pi
#: The translation is an affine function of the first joint within this fraction of its movement in the second
#: direction: a pelvis that was measured separately moves nearly like the translation.
_SAME = 0.15
#: Bound of the distance between the means of the two, as a fraction of the larger mean: a pelvis is 0.24 m below
#: SMPL's translation; rotation vectors that circle as the dancer does have a mean far from the dancer's height.
_PLACE = 0.5
#: Least correlation of the mean lengths of 21 bones with SMPL's: 0.87 to 1 for positions of people, at most 0.73 for
#: rotation vectors of 4,800 smooth motions, some of which circle and so are rigid as well.
_HUMAN = 0.8
#: A movement along a line has a smaller ratio of its second to its first extent, and is not evidence.
_LINE = 0.02
#: Tolerance of the orthonormality of the two rows of a 6D rotation; files in float32 are within 1e-7.
_TOLERANCE_6D = 1e-3
#: Indices of FineDance's joints in the skeleton: all except jaw and eyes.
_OF_55 = [SMPLX55.index(joint) for joint in SMPLX52.joints]

Floats = NDArray[np.float64]


#: Shape of a frame: () one number, (72,) columns, (24, 3) vectors.
Shape = tuple[int, ...]


def read_frames(arrays: ArrayFile, shapes: Mapping[str, Sequence[Shape]], fix: str = "") -> list[Floats]:
    """Return arrays (T, n) by key: there, with frames of one of the shapes, equally long, finite; else DataError."""
    fix, path = fix or DOWNLOAD_AGAIN, arrays.path
    require_keys(arrays, tuple(shapes))
    read = {key: arrays.read(key) for key in shapes}
    for key, array in read.items():
        if array.shape == (0,):
            raise no_frames(path)
        if not array.ndim or array.shape[1:] not in shapes[key]:
            allowed = " or ".join(f"(T, {', '.join(map(str, shape))})" for shape in shapes[key] if shape)
            raise bad_shape(path, key, array.shape, allowed, fix)
    (first, n), *others = ((key, len(array)) for key, array in read.items())
    for key, length in others:
        if length != n:
            raise lengths_differ(path, first, n, key, length, fix)
    if not n:
        raise no_frames(path)
    for key, array in read.items():
        require_finite(path, key, array, fix)
    return [array.reshape(n, -1) for array in read.values()]


def require_keys(arrays: ArrayFile, keys: Sequence[str], allowed: str = "") -> None:
    """Raise DataError, ``missing_key``, unless a file has its keys; `allowed` tells more than their names."""
    missing = [key for key in keys if key not in arrays.names]
    if missing:
        raise DataError(f"the motion file has no {' and no '.join(missing)}", reason="missing_key",
                        where=str(arrays.path), found=f"keys {listed(arrays.names, show=quoted) or 'none'}",
                        allowed=f"a dict with {allowed or ', '.join(keys)}", fix=DOWNLOAD_AGAIN)  # fmt: skip


def require_finite(path: Path, what: str, array: Floats, fix: str = DOWNLOAD_AGAIN, *, columns: bool = False) -> None:
    """Raise DataError, ``nan`` with the frame, and the column if `columns`, unless an array (T, ...) is finite."""
    finite = np.isfinite(array.reshape(len(array), -1))
    bad = np.asarray(~finite.all(axis=1))
    if bad.any():
        frame = int(bad.argmax())
        column = f", column {int(finite[frame].argmin())}" if columns else ""
        raise DataError(f"{what} contains values that are not finite", reason="nan",
                        where=f"{path}, frame {frame}{column}",
                        found=f"{int(bad.sum())} of {len(bad)} frames with NaN or infinity", fix=fix)  # fmt: skip


def bad_shape(path: Path, key: str, found: object, allowed: str, fix: str = DOWNLOAD_AGAIN) -> DataError:
    """Return the error for an array of another shape."""
    problem = f"{key} has the wrong shape"
    return DataError(problem, reason="bad_shape", where=str(path), found=str(found), allowed=allowed, fix=fix)


def lengths_differ(path: Path, a: str, n_a: int, b: str, n_b: int, fix: str = DOWNLOAD_AGAIN) -> DataError:
    """Return the error for two arrays, a and b, with different numbers of frames."""
    return DataError(f"{a} and {b} differ in length", reason="length_mismatch", where=str(path),
                     found=f"{n_a} and {n_b} frames", fix=fix)  # fmt: skip


def no_frames(path: Path) -> DataError:
    """Return the error for a motion without frames."""
    return DataError("the motion has no frames", reason="empty", where=str(path), fix=DOWNLOAD_AGAIN)


def require_dancer(path: Path, member: int, dancers: int) -> None:
    """Raise DataError, ``missing_dancer``, if a file with this number of dancers has no dancer `member`."""
    if not 0 <= member < dancers:
        raise DataError(f"there is no dancer {member}", reason="missing_dancer", where=str(path),
                        found=f"{dancers} dancers")  # fmt: skip


def require_matrices(
    where: str,
    matrices: Floats,
    joints: Sequence[str],
    tolerance: float = _TOLERANCE_MATRIX,
    determinant: float = _TOLERANCE_MATRIX,
    fix: str = DOWNLOAD_AGAIN,
) -> None:
    """Raise DataError, ``bad_rotation`` with frame and joint, unless (T, J, 3, 3) are rotation matrices."""
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-2, -1))
        off_1 = np.abs(np.linalg.det(matrices) - 1)
    bad = ~((off <= tolerance) & (off_1 <= determinant))
    if bad.any():
        frame, joint = (int(k) for k in np.argwhere(bad)[0])
        raise DataError("not a rotation matrix", reason="bad_rotation",
                        where=f"{where}, frame {frame}, joint {joints[joint]}",
                        found=f"R R^T is {off[frame, joint]:.3g} off, the determinant {off_1[frame, joint]:.3g}; "
                              f"{int(bad.any(axis=1).sum())} of {len(bad)} frames",
                        allowed=f"orthonormal within {tolerance:g}, determinant 1 within {determinant:g}",
                        fix=fix)  # fmt: skip


def up_axis(path: Path, spine: NDArray[np.float64], up: str, dataset: str, axes: Sequence[str] = ("y", "z")) -> str:
    """Return the axis that is up in a file: `up`, or for "auto" the one of `axes` that is along the spine."""
    cosines = dict(zip("xyz", spine / max(float(np.linalg.norm(spine)), 1e-9), strict=True))
    clear = next((axis for axis, value in cosines.items() if abs(value) >= _UPRIGHT_COSINE), "")
    clear = f"-{clear}" if clear and cosines[clear] < 0 else clear
    if up != "auto" and clear in ("", up):
        return up
    if up == "auto" and clear in axes:
        return clear
    signed = [axis if axis.startswith("-") else f"+{axis}" for axis in axes]
    stated = up if up.startswith("-") else f"+{up}"
    raise DataError(
        "the axis that is up is not clear" if up == "auto" else f"heads are not above pelvises along {stated}",
        reason="bad_axes",
        where=str(path),
        found="cosines of the spines " + ", ".join(f"{axis} {value:.2f}" for axis, value in cosines.items()),
        allowed=f"at least {_UPRIGHT_COSINE} along {' or '.join(signed)}",
        fix=f"set dataset.{dataset}.up to the axis that is up, {' or '.join(axes)}, or leave the file out",
    )


def require_upright(path: Path, motion: Motion, allowed: str) -> None:
    """Raise DataError, ``bad_axes``, for a file in which the body certainly does not stand upright."""
    wrong = wrong_up(motion.joints())
    if wrong is not None and wrong[1]:
        raise DataError("the body does not stand upright", reason="bad_axes", where=str(path),
                        found=f"from feet to head {np.array2string(wrong[0], precision=2)} on average",
                        allowed=allowed, fix="use the published file")  # fmt: skip


def spine_of(motion: Motion) -> Floats:
    """Return the vector (3,) from pelvis to head, on average."""
    joints = motion.joints()
    return np.asarray((joints[:, motion.skeleton.index("head")] - joints[:, 0]).mean(axis=0))


def upright(motion: Motion, up: str) -> Motion:
    """Return a motion whose axis `up` is up, turned to +Y up about the world's origin: dancers stay together."""
    turn, rest = UPRIGHT[up], motion.skeleton.offsets[0]
    rotations = motion.rotations.copy()
    rotations[:, 0] = rotvec_from_matrix(turn @ matrix_from_rotvec(rotations[:, 0]))
    return Motion((motion.translation + rest) @ turn.T - rest, rotations, motion.grid, motion.skeleton)


def require_rotations(path: Path, what: str, rotations: Floats, translation: Floats, parents: Sequence[int]) -> None:
    """Raise DataError, ``not_rotations``, if axis-angle rotations are joint positions or angles in degrees.

    `rotations`: (T, J, 3), finite; the first 22 joints are SMPL's. `translation`: (T, 3) in the file's unit.
    """
    step = max(1, len(rotations) // _MAX_FRAMES)
    points, root = rotations[::step], translation[::step]
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers near the limits of their range
        evidence = _root_is_translation(points[:, 0], root) or _bones_keep_their_length(points, parents)
        lengths = _lengths(points[:, 1:])
        turned = lengths[lengths > 0]  # a body without hands and face has zeros for them
        median = float(np.median(turned)) if len(turned) else 0.0
    if evidence:
        raise _not_rotations(path, f"{what} contains joint positions, not rotations", evidence, POSITIONS)
    if median > _LONGEST_MEDIAN:
        fix = f"convert degrees to radians. If they are positions: {POSITIONS}"
        found = f"vectors of length {median:.3g} (median over frames and joints that turn, except the first)"
        raise _not_rotations(path, f"{what} does not contain rotation vectors in radians", found, fix)


def _root_is_translation(first: Floats, translation: Floats) -> str:
    """Return the evidence if the first joint moves as the translation does, in any units; else ""."""
    places = first.mean(axis=0), translation.mean(axis=0)
    first, translation = first - places[0], translation - places[1]
    size = float((first**2).sum())
    if len(first) < _LEAST_FRAMES or not 1e-12 < size < np.inf:
        return ""
    factor = float((first * translation).sum()) / size
    if not 0 < factor < np.inf:
        return ""
    extents = np.linalg.svd(factor * first, compute_uv=False)
    rest = float(np.sqrt(((translation - factor * first) ** 2).sum()))
    same = extents[1] > _LINE * extents[0] and rest <= _SAME * extents[1]
    pelvis, path = factor * places[0], places[1]
    tolerance = _PLACE * max(np.linalg.norm(pelvis), np.linalg.norm(path)) + _SAME * extents[1] / np.sqrt(len(first))
    near = np.linalg.norm(pelvis - path) <= tolerance
    return "the first joint moves like the translation" if same and near else ""


def _bones_keep_their_length(points: Floats, parents: Sequence[int]) -> str:
    """Return the evidence if the distances between joints and their parents are constant, as of a body; else ""."""
    bones = points[:, 1:] - points[:, list(parents[1:])]
    length = _lengths(bones)
    moves = _lengths(bones.std(axis=0))
    # Hands that do not turn would all give the length of the wrist's rotation, as often as they have joints.
    moving = (points[:, 1:] != points[:1, 1:]).any(axis=(0, 2))
    judged = moving & (moves > _MOVES * length.mean(axis=0))
    if len(points) < _LEAST_FRAMES or judged.sum() < _LEAST_BONES or not is_human(length.mean(axis=0)):
        return ""
    share = length.std(axis=0)[judged] / moves[judged]
    rigid = _RIGID if len(points) >= _MANY_FRAMES else _RIGID_OF_FEW_FRAMES
    if not np.median(share) <= rigid:
        return ""
    n, of = int((share <= rigid).sum()), int(judged.sum())
    return f"the distances of {n} of {of} joints to their parents are constant"


def is_human(bones: Floats) -> bool:
    """Return whether mean distances (J - 1,) of joints to their parents are in the proportions of a body."""
    usual = _lengths(np.asarray(SMPL24.offsets[1 : len(BODY_JOINTS)]))
    return len(bones) >= len(usual) and bool(np.corrcoef(bones[: len(usual)], usual)[0, 1] >= _HUMAN)


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths of vectors (..., 3), as numpy.linalg.norm, in a tenth of its time."""
    squares = vectors * vectors
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])


def _not_rotations(path: Path, problem: str, found: str, fix: str) -> DataError:
    return DataError(
        problem, reason="not_rotations", where=str(path), found=found, allowed="axis-angle, radians", fix=fix
    )


def rotations_of(rows: Floats) -> Floats:
    """Return axis-angle rotations (T, 55, 3) in radians of FineDance's (T, 52, 6); jaw and eyes are zero."""
    rotations = np.zeros((len(rows), SMPLX55.n_joints, 3))
    rotations[:, _OF_55] = rotvec_from_matrix(matrix_from_6d(rows))
    return rotations


def check_rows(path: Path, rows: Floats) -> None:
    """Raise DataError, ``bad_rotation``, unless 6D rotations (T, 52, 6) are two rows of a rotation matrix."""
    off = _off_orthonormal(rows[..., :3], rows[..., 3:])
    bad = off > _TOLERANCE_6D
    if not bad.any():
        return
    frame, joint = (int(i) for i in np.argwhere(bad)[0])
    value = ", ".join(f"{x:.4g}" for x in rows[frame, joint])
    fix = "normalise the rotations (Gram-Schmidt) if a model generated them, or download the file again"
    # The pattern of two columns, flattened row by row (r00 r01 r10 r11 r20 r21).
    if (_off_orthonormal(rows[..., 0::2], rows[..., 1::2]) <= _TOLERANCE_6D).all():
        fix = (
            "all of them are valid as two columns of the matrix, flattened row by row (Zhou et al. 2019): write "
            "the first two rows instead"
        )
    raise DataError(
        "not a valid 6D rotation",
        reason="bad_rotation",
        where=f"{path}, frame {frame}, joint {SMPLX52.joints[joint]}",
        found=f"({value}), deviation {off[frame, joint]:.3g}; {int(bad.any(axis=1).sum())} of {len(rows)} frames",
        allowed=f"two rows of a rotation matrix, of length 1 and at right angles within {_TOLERANCE_6D:g}",
        fix=fix,
    )


def _off_orthonormal(a: Floats, b: Floats) -> Floats:
    """Return the deviation of pairs of vectors (..., 3) from length 1 and a right angle: the largest of the three."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = [np.abs(np.linalg.norm(v, axis=-1) - 1) for v in (a, b)]
        off = np.maximum.reduce([*lengths, np.abs(np.sum(a * b, axis=-1))])
    return np.asarray(np.nan_to_num(off, nan=np.inf, posinf=np.inf))
