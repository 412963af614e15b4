"""Forward kinematics and decoding in torch, for losses on joint positions (EDGE, Lodge) and for generated motion.

The numbers are those of `Representation.decode` and `core.motion`, within 1e-5 m in float32; shapes may have any
number of leading axes, everything is differentiable, and nothing waits for the device::

    scaler = train.scaler("edge151")
    generated = joints(scaler.unnormalize(output.float()), "edge151")    # (B, T, 24, 3), metres, +Y up

*Precision.* float64 stays float64; everything else is computed in float32, for any autocast and TF32. So
half-precision input loses what it lost when it was rounded, and no more: the result is float32.

*Memory.* The entries of a matrix are stored apart, each contiguous over the frames of the batch, so that every
operation is a long vector operation; joints are passed one by one, from the root to the leaves.
"""

from dataclasses import dataclass
from math import prod

import torch
from torch import Tensor

from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton

#: Least square of a length by which a vector is divided: as torch.nn.functional.normalize has it.
_TINY = 1e-24
#: Below this square of half an angle's sine or of an angle, series are used, whose next term is below 1e-16.
_NEAR = 1e-6


def working(tensor: Tensor) -> Tensor:
    """Return a tensor in the type that is computed in: float32, or float64 if it is float64."""
    return tensor if tensor.dtype in (torch.float32, torch.float64) else tensor.float()


def matrix_from_6d(rows: Tensor) -> Tensor:
    """Convert 6D rotations (..., 6), two rows, to matrices (..., 3, 3) by Gram-Schmidt (Zhou et al. 2019, eq. 15).

    Six columns that do not span a plane give a finite matrix that is not a rotation, and finite gradients: an
    untrained network may return them, and a check would wait for the device.
    """
    return matrix_of_rows(working(rows).movedim(-1, 0)).movedim((0, 1), (-2, -1))


def matrix_of_rows(rows: Tensor) -> Tensor:
    """Return the matrices (3, 3, ...) of 6D rotations (6, ...): `matrix_from_6d` with the entries first."""
    first, second = rows[:3], rows[3:]
    a = first * _inverse_length(first)
    b = second - (a * second).sum(0) * a
    b = b * _inverse_length(b)
    c = torch.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    return torch.stack([a, b, c])


def matrix_from_rotvec(rotvec: Tensor) -> Tensor:
    """Convert axis-angle vectors (..., 3), radians, to matrices (..., 3, 3); lengths beyond pi are allowed."""
    x, y, z = working(rotvec).unbind(-1)
    square = x * x + y * y + z * z
    near = square < _NEAR
    # The root has no derivative at 0, and autograd multiplies by it even where the other branch is taken.
    angle = torch.where(near, torch.ones_like(square), square).sqrt()
    scale = torch.where(near, 0.5 - square / 48 + square * square / 3840, torch.sin(angle / 2) / angle)
    w = torch.where(near, 1 - square / 8 + square * square / 384, torch.cos(angle / 2))
    x, y, z = x * scale, y * scale, z * scale
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    entries = (
        *(1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)),
        *(2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)),
        *(2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)),
    )
    return torch.stack(entries, dim=-1).reshape(*square.shape, 3, 3)


def rotvec_from_matrix(matrix: Tensor) -> Tensor:
    """Convert matrices (..., 3, 3) to axis-angle vectors (..., 3) of length at most pi.

    The derivative has a jump where the angle is pi, as the vector has. By way of quaternions, the largest of whose
    four numbers is found first (Shepperd 1978), so that nothing is divided by a small number.
    """
    m = working(matrix)
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    # Four times the products of the quaternion's numbers with each other.
    squares = torch.stack([1 + trace, *(1 + 2 * m[..., k, k] - trace for k in range(3))], dim=-1)
    wx, wy, wz = (m[..., b, a] - m[..., a, b] for a, b in ((1, 2), (2, 0), (0, 1)))
    xy, xz, yz = (m[..., b, a] + m[..., a, b] for a, b in ((0, 1), (0, 2), (1, 2)))
    ww, xx, yy, zz = squares.unbind(-1)
    products = torch.stack([ww, wx, wy, wz, wx, xx, xy, xz, wy, xy, yy, yz, wz, xz, yz, zz], dim=-1)
    largest = squares.argmax(dim=-1, keepdim=True)[..., None].expand(*squares.shape[:-1], 1, 4)
    row = products.reshape(*squares.shape, 4).gather(-2, largest)[..., 0, :]
    quaternion = row / (2 * squares.amax(dim=-1, keepdim=True).sqrt())
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    w, vector = quaternion[..., 0], quaternion[..., 1:]
    square = (vector * vector).sum(-1)
    near = square < _NEAR
    sine = torch.where(near, torch.ones_like(square), square).sqrt()
    series = 2 + square / 3 + 3 * square * square / 20
    return vector * torch.where(near, series, 2 * torch.atan2(sine, w) / sine)[..., None]


def _inverse_length(vectors: Tensor) -> Tensor:
    return (vectors * vectors).sum(0).clamp_min(_TINY).rsqrt()


@dataclass(frozen=True, eq=False)
class Poses:
    """Decoded motion as tensors: metres, +Y up.

    Attributes
    ----------
    skeleton
        J joints.
    translation
        (..., 3) SMPL's translation; the posed root is at skeleton.offsets[0] + translation.
    matrices
        (..., J, 3, 3) rotations relative to the parents.
    contacts
        (..., 4) left ankle, right ankle, left toe, right toe, as in the columns; None if they have none.
    """

    skeleton: Skeleton
    translation: Tensor
    matrices: Tensor
    contacts: Tensor | None = None

    def joints(self, skeleton: Skeleton | None = None) -> Tensor:
        """Return joint positions (..., J, 3), metres.

        `skeleton`: Bones with as many joints and the same parents, such as SMPL24_EDGE for EDGE's root; default: own.
        """
        return forward_kinematics(skeleton or self.skeleton, self.matrices, self.translation)

    def rotations(self) -> Tensor:
        """Return axis-angle vectors (..., J, 3), radians, of length at most pi."""
        return rotvec_from_matrix(self.matrices)

    def __repr__(self) -> str:
        return f"Poses({tuple(self.translation.shape[:-1])} frames, skeleton {self.skeleton.name})"


def forward_kinematics(skeleton: Skeleton, rotations: Tensor, translation: Tensor) -> Tensor:
    """Return joint positions, as `core.motion.forward_kinematics` does.

    Parameters
    ----------
    skeleton
        J joints. The posed root is at offsets[0] + translation, as in SMPL (Loper et al. 2015).
    rotations
        (..., J, 3) axis-angle, radians, or (..., J, 3, 3) matrices, each relative to the parent.
    translation
        (..., 3) metres, with the same leading axes.

    Returns
    -------
    (..., J, 3)
        Positions in metres, in the axes of the input; float32, or float64 if both are.

    Raises
    ------
    UsageError
        If the shapes do not match each other and the skeleton.
    """
    lead, n_joints = translation.shape[:-1], skeleton.n_joints
    if translation.shape[-1:] != (3,) or rotations.shape not in ((*lead, n_joints, 3), (*lead, n_joints, 3, 3)):
        raise UsageError(
            "forward_kinematics: the shapes of rotations and translation do not match",
            found=f"rotations {tuple(rotations.shape)}, translation {tuple(translation.shape)}",
            allowed=f"(..., {n_joints}, 3) or (..., {n_joints}, 3, 3), and (..., 3), for skeleton {skeleton.name}",
        )
    matrices = matrix_from_rotvec(rotations) if rotations.dim() == len(lead) + 2 else working(rotations)
    n_frames = prod(lead)
    local = matrices.reshape(n_frames, n_joints, 3, 3).permute(1, 2, 3, 0).contiguous()
    root = working(translation).reshape(n_frames, 3).t().contiguous()
    return _positions(skeleton, local, root).permute(2, 0, 1).reshape(*lead, n_joints, 3)


def decode(columns: Tensor, representation: str | Representation) -> Poses:
    """Decode the columns of a representation, as its own `decode` does with numpy.

    Parameters
    ----------
    columns
        (..., D), or (..., T, D) where the root's path is a sum (lda61), not normalised. Six columns need not be
        orthonormal: Gram-Schmidt turns them into a rotation. The nine of fact219 are taken as they are: project a
        network's output to the nearest rotations first.
    representation
        Name of a registered representation, or a representation with parameters.

    Returns
    -------
    Poses
        With the leading axes of `columns`; +Y up, also for edge151. NaN stays NaN: nothing is checked, as that would
        wait for the device.

    Raises
    ------
    UsageError
        For another width, and for a representation that holds no rotations.
    """
    plugin = _plugin(columns, representation)
    layout = plugin.columns
    if "root_way" in layout.names:
        return _walked(working(columns), plugin)
    kind = next((name for name in _ROWS if name in layout.names), None)
    if kind is None or "translation" not in layout.names:
        raise UsageError(
            f"{plugin.name} cannot be decoded in torch: it does not consist of a translation and rotations",
            found=", ".join(layout.names),
            fix="dancedata.torch.kinematics.joints takes representations that hold positions",
        )
    lead, n_joints = columns.shape[:-1], plugin.skeleton.n_joints
    flat = working(columns).reshape(prod(lead), layout.width).t().contiguous()
    entries = flat[layout.slice(kind)].reshape(n_joints, 3 * _ROWS[kind], -1)
    if kind == "rotation_6d":
        local = matrix_of_rows(entries.transpose(0, 1)).permute(2, 0, 1, 3)
    else:
        local = entries.reshape(n_joints, 3, 3, -1)
    root = flat[layout.slice("translation")]
    if plugin.spatial is not None and plugin.spatial.up == "z":
        local, root = torch.cat([_y_up(local[0])[None], local[1:]]), _y_up(root)
    contacts = columns[..., layout.slice("contact")] if "contact" in layout.names else None
    matrices = local.permute(3, 0, 1, 2).reshape(*lead, n_joints, 3, 3)
    return Poses(plugin.skeleton, root.t().reshape(*lead, 3), matrices, contacts)


def joints(columns: Tensor, representation: str | Representation, skeleton: Skeleton | None = None) -> Tensor:
    """Return the joint positions of columns, for representations of rotations and of positions alike.

    Parameters
    ----------
    columns
        (..., D), not normalised. (..., T, D) where the root's path is a sum of steps (HumanML3D, lda61): the path
        begins at the origin in the first of the T rows.
    representation
        Name of a registered representation, or a representation with parameters.
    skeleton
        Bones for representations of rotations, see `Poses.joints`.

    Returns
    -------
    (..., J, 3)
        Metres, +Y up; float32, or float64 if `columns` is.

    Raises
    ------
    UsageError
        For another width, a representation whose positions are unknown, or bones for given positions.
    """
    plugin = _plugin(columns, representation)
    names = plugin.columns.names
    if "position" not in names and "local_position" not in names:
        return decode(columns, plugin).joints(skeleton)
    if skeleton is not None:
        raise UsageError(f"{plugin.name} holds positions, which cannot be put on other bones", found=skeleton.name)
    if "local_position" in names:
        return _on_the_path(working(columns), plugin.columns)
    places = working(columns)[..., plugin.columns.slice("position")]
    return places.reshape(*columns.shape[:-1], plugin.skeleton.n_joints, 3)


#: Rows of a matrix that groups of columns hold for each joint.
_ROWS = {"rotation_6d": 2, "rotation_matrix": 3}


def _plugin(columns: Tensor, representation: str | Representation) -> Representation:
    plugin = REPRESENTATIONS.get(representation)() if isinstance(representation, str) else representation
    if columns.shape[-1] != plugin.columns.width:
        raise UsageError(
            f"{plugin.name} decodes (..., {plugin.columns.width})", found=f"shape {tuple(columns.shape)}"
        )
    return plugin


def _on_the_path(columns: Tensor, layout: Columns) -> Tensor:
    """Return joints (..., T, J, 3) of HumanML3D's columns, as its `recover_from_ric` does; sums in float64."""
    turn, step, height, local = (
        columns[..., layout.slice(name)] for name in ("root_turn", "root_velocity", "root_height", "local_position")
    )
    still = torch.zeros_like(columns[..., :1, :1]).double()
    facing = torch.cat([still, -2 * turn[..., :-1, :].double().cumsum(-2)], dim=-2)
    ahead = torch.cat([still.expand(*still.shape[:-1], 2), step[..., :-1, :].double()], dim=-2)
    path = _turned(ahead[..., 0], ahead[..., 1], facing[..., 0])
    x, z = (axis.cumsum(-1).to(columns.dtype)[..., None] for axis in path)
    relative = local.reshape(*local.shape[:-1], local.shape[-1] // 3, 3)
    east, south = _turned(relative[..., 0], relative[..., 2], facing.to(columns.dtype))
    root = torch.stack([x, height, z], dim=-1)
    return torch.cat([root, torch.stack([east + x, relative[..., 1], south + z], dim=-1)], dim=-2)


def _walked(columns: Tensor, plugin: Representation) -> Poses:
    """Return the poses of LDA's columns (..., T, D), whose ways and turns lead to a row; sums in float64."""
    layout, skeleton = plugin.columns, plugin.skeleton
    turn, way, height = (columns[..., layout.slice(name)] for name in ("root_turn", "root_way", "root_height"))
    facing = torch.cat([torch.zeros_like(turn[..., :1, 0]), turn[..., 1:, 0]], dim=-1).double().cumsum(-1)
    ahead = torch.cat([torch.zeros_like(way[..., :1, :]), way[..., 1:, :]], dim=-2).double()
    x, z = (axis.cumsum(-1).to(columns.dtype) for axis in _turned(ahead[..., 0], ahead[..., 1], facing))
    translation = torch.stack([x, height[..., 0], z], dim=-1) / 100 - columns.new_tensor(skeleton.offsets[0])
    angles = columns[..., layout.slice("axis_angle")]
    held = matrix_from_rotvec(angles.reshape(*angles.shape[:-1], -1, 3))
    upright = torch.stack([torch.zeros_like(facing), facing, torch.zeros_like(facing)], dim=-1).to(columns.dtype)
    parts = next(group.parts for group in layout.groups if group.name == "axis_angle")
    joints = {part.rpartition(".")[0]: None for part in parts}
    local = dict(zip(joints, held.unbind(-3), strict=True))
    local[skeleton.joints[0]] = matrix_from_rotvec(upright) @ local[skeleton.joints[0]]
    still = torch.eye(3, dtype=columns.dtype, device=columns.device).expand_as(held[..., 0, :, :])
    matrices = torch.stack([local.get(name, still) for name in skeleton.joints], dim=-3)
    return Poses(skeleton, translation, matrices)


def _turned(x: Tensor, z: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    cosine, sine = angle.cos(), angle.sin()
    return cosine * x + sine * z, cosine * z - sine * x


def _y_up(rows: Tensor) -> Tensor:
    """Turn x, y, z (3, ...) of a world whose z axis points up: (x, y, z) -> (x, z, -y)."""
    return torch.stack([rows[0], rows[2], -rows[1]])


def _positions(skeleton: Skeleton, local: Tensor, root: Tensor) -> Tensor:
    """Return joint positions (J, 3, n) from matrices (J, 3, 3, n) and translations (3, n)."""
    # Bones are numbers, not tensors: nothing is copied to the device.
    bones, parents = skeleton.offsets.tolist(), skeleton.parents
    places = [torch.stack([row + offset for row, offset in zip(root, bones[0], strict=True)])]
    world: list[Tensor] = [local[0]]
    for joint in range(1, skeleton.n_joints):
        parent, place = world[parents[joint]], places[parents[joint]]
        for axis, offset in enumerate(bones[joint]):
            place = torch.add(place, parent[:, axis], alpha=offset)
        places.append(place)
        # The rotation of a leaf does not move anything.
        world.append(_product(parent, local[joint]) if joint in parents else local[joint])
    return torch.stack(places)


def _product(a: Tensor, b: Tensor) -> Tensor:
    """Return the products of matrices (3, 3, n). Autocast and TF32 leave elementwise operations alone."""
    result = a[:, 0, None] * b[None, 0]
    result = torch.addcmul(result, a[:, 1, None], b[None, 1])
    return torch.addcmul(result, a[:, 2, None], b[None, 2])
