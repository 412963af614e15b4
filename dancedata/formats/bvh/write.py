"""Writes BVH files, for the example of the dataset `folder` and for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core import atomic

__all__ = ["write_bvh"]

Floats = NDArray[np.float64]


def write_bvh(
    path: Path,
    names: Sequence[str],
    parents: Sequence[int],
    offsets: Floats,
    rotations: Floats,
    root: Floats,
    frame_time: str,
    orders: Sequence[str] | str = "ZYX",
) -> None:
    """Write a skeleton and its motion.

    Parameters
    ----------
    offsets : (J, 3) from the parents, in the file's unit.
    rotations : (T, J, 3, 3) relative to the parents.
    root : (T, 3) positions of the root.
    frame_time : seconds, as text for the file.
    orders : order of the rotation channels, for all joints or for each.
    """
    from scipy.spatial.transform import Rotation

    orders = [orders] * len(names) if isinstance(orders, str) else list(orders)
    lines = ["HIERARCHY"]
    _block(lines, 0, 0, names, parents, offsets, orders)
    columns = [np.asarray(root, dtype=np.float64)]
    for joint in _file_order(parents):
        order: Any = orders[joint]
        columns.append(np.asarray(Rotation.from_matrix(rotations[:, joint]).as_euler(order, degrees=True)))
    rows = np.concatenate(columns, axis=1)
    lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    atomic.write_text(path, "\n".join(lines) + "\n")


def _file_order(parents: Sequence[int], joint: int = 0) -> list[int]:
    """Return the joints in depth-first order, children in their order."""
    order = [joint]
    for child, parent in enumerate(parents):
        if parent == joint:
            order += _file_order(parents, child)
    return order


def _block(
    lines: list[str],
    joint: int,
    depth: int,
    names: Sequence[str],
    parents: Sequence[int],
    offsets: Floats,
    orders: Sequence[str],
) -> None:
    indent = "\t" * depth
    position = "Xposition Yposition Zposition " if depth == 0 else ""
    rotation = " ".join(f"{axis}rotation" for axis in orders[joint])
    children = [child for child, parent in enumerate(parents) if parent == joint]
    lines += [
        f"{indent}{'JOINT' if depth else 'ROOT'} {names[joint]}",
        f"{indent}{{",
        f"{indent}\tOFFSET {' '.join(f'{value:.6f}' for value in offsets[joint])}",
        f"{indent}\tCHANNELS {6 if depth == 0 else 3} {position}{rotation}",
    ]
    for child in children:
        _block(lines, child, depth + 1, names, parents, offsets, orders)
    if not children:
        lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET 0.0 0.0 0.0", f"{indent}\t}}"]
    lines.append(f"{indent}}}")
