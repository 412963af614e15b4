"""Writes BVH files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.motion import Motion
from dancedata.files import atomic

Floats = NDArray[np.float64]

#: Units per metre.
UNITS = {"m": 1.0, "cm": 100.0}
#: Length of the bone that ends a limb, as a part of the bone before it; viewers draw nothing without one.
_END = 0.5


def motion_bvh(motion: Motion, unit: Literal["m", "cm"] = "m") -> str:
    """Return a motion as the text of a BVH file, +Y up, with the bones of its skeleton at rest.

    The root's offset is 0 and its position channels hold its position, so that programs that add the offset and
    programs that do not agree. Angles are those of R = Rz Ry Rx, in degrees.

    Parameters
    ----------
    unit
        Of lengths: metres, or centimetres, which most programs for animation use.
    """
    scale, skeleton = UNITS[unit], motion.skeleton
    offsets = scale * np.array(skeleton.offsets)
    offsets[0] = 0
    root = scale * (motion.translation + skeleton.offsets[0])
    period = f"{float(1 / motion.grid.rate):.10f}"
    ends = _END * offsets
    return bvh_text(skeleton.joints, skeleton.parents, offsets, motion.matrices, root, period, ends=ends)


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
    """Write a skeleton and its motion; the parameters are those of `bvh_text`."""
    atomic.write_text(path, bvh_text(names, parents, offsets, rotations, root, frame_time, orders))


def bvh_text(
    names: Sequence[str],
    parents: Sequence[int],
    offsets: Floats,
    rotations: Floats,
    root: Floats,
    frame_time: str,
    orders: Sequence[str] | str = "ZYX",
    ends: Floats | None = None,
) -> str:
    """Return the text of a file with a skeleton and its motion.

    Parameters
    ----------
    offsets
        (J, 3) from the parents, in the file's unit.
    rotations
        (T, J, 3, 3) relative to the parents.
    root
        (T, 3) positions of the root.
    frame_time
        Seconds, as text for the file.
    orders
        Order of the rotation channels, for all joints or for each.
    ends
        (J, 3) offsets of the ends of joints without children; None: 0.
    """
    from scipy.spatial.transform import Rotation

    orders = [orders] * len(names) if isinstance(orders, str) else list(orders)
    ends = np.zeros((len(names), 3)) if ends is None else ends
    lines, order = ["HIERARCHY"], list[int]()

    def add_block(joint: int, indent: str) -> None:
        order.append(joint)
        position = "3 " if indent else "6 Xposition Yposition Zposition "
        rotation = " ".join(f"{axis}rotation" for axis in orders[joint])
        lines.extend(
            f"{indent}{line}"
            for line in (
                f"{'JOINT' if indent else 'ROOT'} {names[joint]}",
                "{",
                f"\tOFFSET {' '.join(f'{value:.6f}' for value in offsets[joint])}",
                f"\tCHANNELS {position}{rotation}",
            )
        )
        children = [child for child, parent in enumerate(parents) if parent == joint]
        for child in children:
            add_block(child, indent + "\t")
        if not children:
            end = " ".join(f"{value:.6f}" if value else "0.0" for value in ends[joint])
            lines.extend(f"{indent}\t{line}" for line in ("End Site", "{", f"\tOFFSET {end}", "}"))
        lines.append(f"{indent}}}")

    add_block(0, "")
    columns = [np.asarray(root, dtype=np.float64)]
    for joint in order:
        axes: Any = orders[joint]
        columns.append(np.asarray(Rotation.from_matrix(rotations[:, joint]).as_euler(axes, degrees=True)))
    rows = np.concatenate(columns, axis=1)
    lines += ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time}"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"
