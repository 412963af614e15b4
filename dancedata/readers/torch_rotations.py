"""Conversions of rotations in torch: differentiable, batched, on any device; the counterpart of `core.rotations`.

They are written with elementwise operations only: autocast and TF32 do not change their precision. Half-precision
input is converted to float32, and so is the result.
"""

from __future__ import annotations

import torch
from torch import Tensor

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


def rotation_6d(matrix: Tensor) -> Tensor:
    """Return the first two rows of matrices (..., 3, 3), flattened to (..., 6)."""
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def _inverse_length(vectors: Tensor) -> Tensor:
    """Return 1 / length of vectors (3, ...), finite for all of them."""
    return (vectors * vectors).sum(0).clamp_min(_TINY).rsqrt()
