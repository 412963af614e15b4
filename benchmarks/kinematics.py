"""Columns to joint positions: torch here, numpy here, and EDGE's own way, all in one run on one machine.

    python benchmarks/kinematics.py                 edge151, a batch of 64 windows of 150 frames, 9 rounds
    python benchmarks/kinematics.py --quick         8 windows, 3 rounds
    python benchmarks/kinematics.py --device cuda

EDGE (Tseng et al., CVPR 2023) computes its loss on joints from columns as follows: 6D to matrix to quaternion to
axis-angle (`ax_from_6v` of dataset/quaternion.py, with pytorch3d), axis-angle to quaternion, then joint by joint
(`SMPLSkeleton.forward` of vis.py). `EdgeSkeleton` is that loop; the conversions, which EDGE takes from pytorch3d, are
rewritten here from the same formulas. The results are compared before anything is measured.

A measurement is one call of one way; "and gradients" is that with the backward pass of the mean square. On a CPU it
is CPU time, so that other processes matter little; on a GPU it is the time until the device is done. Rounds are
interleaved. Medians, and the ratio to this package's torch version: above 1 the other way takes longer.
"""

# EdgeSkeleton.forward follows vis.py of https://github.com/Stanford-TML/EDGE, which is under the MIT licence:
#
# Copyright (c) 2023 Jonathan Tseng
#
# Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
# documentation files (the "Software"), to deal in the Software without restriction, including without limitation
# the rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to
# permit persons to whom the Software is furnished to do so, subject to the following conditions:
#
# The above copyright notice and this permission notice shall be included in all copies or substantial portions of
# the Software.
#
# THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO
# THE WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
# AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT,
# TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
# SOFTWARE.

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE
from dancedata.torch.kinematics import joints

REPRESENTATION = "edge151"


class EdgeSkeleton:
    """EDGE's skeleton, and its forward kinematics joint by joint with quaternions."""

    def __init__(self, device: str) -> None:
        self.offsets = torch.tensor(SMPL24_EDGE.offsets.copy(), dtype=torch.float32, device=device)
        self.parents = SMPL24_EDGE.parents

    def forward(self, rotations: Tensor, root_positions: Tensor) -> Tensor:
        """Return joints (N, L, J, 3) from axis-angle (N, L, J, 3) and root positions (N, L, 3)."""
        rotations = axis_angle_to_quaternion(rotations)
        positions_world: list[Tensor] = []
        rotations_world: list[Tensor | None] = []
        offsets = self.offsets.expand(rotations.shape[0], rotations.shape[1], *self.offsets.shape)
        for i, parent in enumerate(self.parents):
            if parent == -1:
                positions_world.append(root_positions)
                rotations_world.append(rotations[:, :, 0])
                continue
            turned = rotations_world[parent]
            assert turned is not None
            positions_world.append(quaternion_apply(turned, offsets[:, :, i]) + positions_world[parent])
            has_children = i in self.parents
            rotations_world.append(quaternion_multiply(turned, rotations[:, :, i]) if has_children else None)
        return torch.stack(positions_world, dim=3).permute(0, 1, 3, 2)


def edges_way(columns: Tensor, skeleton: EdgeSkeleton) -> Tensor:
    """Return joints (N, L, 24, 3), +Z up, as EDGE's loss does."""
    n, length, _ = columns.shape
    rotations = ax_from_6v(columns[:, :, 7:].reshape(n, length, -1, 6))
    return skeleton.forward(rotations, columns[:, :, 4:7])


def ax_from_6v(q: Tensor) -> Tensor:
    """6D to axis-angle through matrix and quaternion."""
    a = F.normalize(q[..., :3], dim=-1)
    b = q[..., 3:] - (a * q[..., 3:]).sum(-1, keepdim=True) * a
    b = F.normalize(b, dim=-1)
    return quaternion_to_axis_angle(matrix_to_quaternion(torch.stack((a, b, torch.cross(a, b, dim=-1)), dim=-2)))


def matrix_to_quaternion(m: Tensor) -> Tensor:
    """Matrix to quaternion, by the best conditioned of four candidates; real part first."""
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = torch.stack([1 + trace, *(1 + 2 * m[..., k, k] - trace for k in range(3))], dim=-1)
    wx, wy, wz = (m[..., b, a] - m[..., a, b] for a, b in ((1, 2), (2, 0), (0, 1)))
    xy, xz, yz = (m[..., b, a] + m[..., a, b] for a, b in ((0, 1), (0, 2), (1, 2)))
    ww, xx, yy, zz = squares.unbind(-1)
    candidates = torch.stack([ww, wx, wy, wz, wx, xx, xy, xz, wy, xy, yy, yz, wz, xz, yz, zz], dim=-1)
    candidates = candidates.reshape(*squares.shape, 4) / (2 * squares.clamp_min(0.01).sqrt()[..., None])
    best = squares.argmax(dim=-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    return candidates.gather(-2, best).squeeze(-2)


def quaternion_to_axis_angle(q: Tensor) -> Tensor:
    """Quaternion to axis-angle."""
    norms = torch.norm(q[..., 1:], p=2, dim=-1, keepdim=True)
    angles = 2 * torch.atan2(norms, q[..., :1])
    return q[..., 1:] / (0.5 * torch.sinc(angles * 0.5 / torch.pi))


def axis_angle_to_quaternion(v: Tensor) -> Tensor:
    """Axis-angle to quaternion."""
    angles = torch.norm(v, p=2, dim=-1, keepdim=True)
    return torch.cat([torch.cos(angles * 0.5), v * 0.5 * torch.sinc(angles * 0.5 / torch.pi)], dim=-1)


def quaternion_raw_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return Hamilton's product."""
    aw, ax, ay, az = torch.unbind(a, -1)
    bw, bx, by, bz = torch.unbind(b, -1)
    ow = aw * bw - ax * bx - ay * by - az * bz
    ox = aw * bx + ax * bw + ay * bz - az * by
    oy = aw * by - ax * bz + ay * bw + az * bx
    oz = aw * bz + ax * by - ay * bx + az * bw
    return torch.stack((ow, ox, oy, oz), -1)


def quaternion_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product with a real part that is not negative."""
    ab = quaternion_raw_multiply(a, b)
    return torch.where(ab[..., :1] < 0, -ab, ab)


def quaternion_apply(q: Tensor, point: Tensor) -> Tensor:
    """Turn points by quaternions."""
    as_quaternion = torch.cat((point.new_zeros((*point.shape[:-1], 1)), point), -1)
    conjugate = q * q.new_tensor([1, -1, -1, -1])
    return quaternion_raw_multiply(quaternion_raw_multiply(q, as_quaternion), conjugate)[..., 1:]


def main() -> None:
    """Make the columns, compare, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="8 windows, 3 rounds")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1, help="of torch and numpy")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    n, rounds = (8, 3) if arguments.quick else (64, 9)
    columns = make_columns(n, 150)
    ways = ways_of(columns, arguments.device)
    compare(columns, arguments.device)
    times = measure(ways, rounds, arguments.device)
    print(f"({n}, 150, {columns.shape[-1]}) on {arguments.device}, {arguments.threads} threads, {platform.machine()}")
    print(f"torch {torch.__version__}, numpy {np.__version__}, {rounds} rounds; medians")
    for name, own in (("joints", "torch"), ("joints and gradients", "torch, and gradients")):
        for way in (way for way in times if way.endswith("gradients") == own.endswith("gradients")):
            ratio = times[way] / times[own]
            print(f"{name:22} {way:34} {1e3 * times[way]:9.1f} ms {ratio:7.1f} times torch")


def make_columns(n: int, length: int) -> np.ndarray:
    """Return (n, length, D) float32 of random turns."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(n * length, SMPL24.n_joints, 3))
    motion = Motion(rng.normal(size=(n * length, 3)), turns, FrameGrid.of(30), SMPL24)
    made = REPRESENTATIONS.get(REPRESENTATION)()
    return made.encode(motion, CONTACTS.get("velocity")()).reshape(n, length, -1)


def numpys_way(columns: np.ndarray) -> np.ndarray:
    """Return joints (N, L, 24, 3), +Y up: decoded into a motion, whose joints are computed."""
    n, length, width = columns.shape
    motion = REPRESENTATIONS.get(REPRESENTATION)().decode(columns.reshape(-1, width), FrameGrid.of(30))
    return motion.joints(SMPL24_EDGE).reshape(n, length, SMPL24.n_joints, 3)


def ways_of(columns: np.ndarray, device: str) -> dict[str, Callable[[], object]]:
    """Return what is measured, by name."""
    tensor, skeleton = torch.from_numpy(columns).to(device), EdgeSkeleton(device)
    leaf = tensor.clone().requires_grad_()

    def backward(positions: Tensor) -> Tensor:
        (gradient,) = torch.autograd.grad(positions.square().mean(), leaf)
        return gradient

    return {
        "torch": lambda: joints(tensor, REPRESENTATION, SMPL24_EDGE),
        "numpy": lambda: numpys_way(columns),
        "EDGE": lambda: edges_way(tensor, skeleton),
        "torch, and gradients": lambda: backward(joints(leaf, REPRESENTATION, SMPL24_EDGE)),
        "EDGE, and gradients": lambda: backward(edges_way(leaf, skeleton)),
    }


def compare(columns: np.ndarray, device: str) -> None:
    """Print how far the ways are apart; EDGE's joints have +Z up."""
    tensor = torch.from_numpy(columns).to(device)
    found = joints(tensor, REPRESENTATION, SMPL24_EDGE).cpu().numpy()
    x, y, z = edges_way(tensor, EdgeSkeleton(device)).cpu().unbind(-1)
    edge = torch.stack([x, z, -y], dim=-1).numpy()
    wanted = numpys_way(columns)
    print(f"largest difference from numpy: torch {np.abs(found - wanted).max():.1e} m, ", end="")
    print(f"EDGE {np.abs(edge - wanted).max():.1e} m")


def measure(ways: dict[str, Callable[[], object]], rounds: int, device: str) -> dict[str, float]:
    """Return seconds by name, medians; the first call of each is not counted."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    times: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(rounds + 1):
        for name, way in ways.items():
            with torch.set_grad_enabled(name.endswith("gradients")):
                start = clock()
                way()
                if device != "cpu":
                    torch.cuda.synchronize()
            if turn:
                times[name].append(clock() - start)
    return {name: statistics.median(found) for name, found in times.items()}


if __name__ == "__main__":
    main()
