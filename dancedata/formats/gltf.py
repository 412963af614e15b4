"""glTF 2.0 as one binary file (.glb): a skeleton with its animation, and the skinned mesh of a body model.

The file has a header, a chunk of JSON and a chunk of numbers (Khronos, glTF 2.0, 4.4). Metres, +Y up, as in motions.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, rotation
from dancedata.core.version import __version__
from dancedata.formats.body_mesh import BodyMesh, rest_joints

Array = npt.NDArray[Any]

#: Component types of glTF by numpy's dtype.
_COMPONENTS = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_VERTICES, _INDICES = 34962, 34963
_MAGIC, _VERSION, _JSON_CHUNK, _BIN_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
#: Colour of the body, linear, and how rough it is.
_COLOUR, _ROUGHNESS = [0.6, 0.6, 0.62, 1.0], 0.7


def motion_glb(motion: Motion, mesh: BodyMesh | None = None) -> bytes:
    """Return a motion as a .glb file, frame k at k / rate seconds; `mesh` is the body model to animate."""
    motion = motion if mesh is None else mesh.on(motion)
    skeleton = motion.skeleton
    file = _Glb()
    # Node 0 is the armature; node 1 + j is joint j.
    nodes: list[dict[str, Any]] = [{"name": skeleton.name.partition(":")[0], "children": [1]}]
    for joint, name in enumerate(skeleton.joints):
        children = [1 + child for child, parent in enumerate(skeleton.parents) if parent == joint]
        node: dict[str, Any] = {"name": name, "translation": skeleton.offsets[joint].tolist()}
        nodes.append({**node, "children": children} if children else node)
    bind = np.tile(np.eye(4), (skeleton.n_joints, 1, 1))
    bind[:, 3, :3] = -rest_joints(skeleton)  # by columns: the move is the last of them
    skin = {
        "joints": list(range(1, 1 + skeleton.n_joints)),
        "inverseBindMatrices": file.add(bind.reshape(-1, 16).astype(np.float32)),
        "skeleton": 0,
    }
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"dancedata {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "skins": [skin],
        "animations": [_animation(motion, file)],
    }
    if mesh is not None:
        document["meshes"] = [_mesh(mesh, file)]
        surface = {"baseColorFactor": _COLOUR, "metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
        document["materials"] = [{"name": "body", "pbrMetallicRoughness": surface}]
        document["scenes"][0]["nodes"].append(len(nodes))
        nodes.append({"name": "body", "mesh": 0, "skin": 0})
    return file.data(document)


def _mesh(mesh: BodyMesh, file: _Glb) -> dict[str, Any]:
    joints, weights = mesh.influences
    small = len(mesh.vertices) <= np.iinfo(np.uint16).max
    attributes = {
        "POSITION": file.add(mesh.vertices, _VERTICES, bounds=True),
        "NORMAL": file.add(mesh.normals, _VERTICES),
        "JOINTS_0": file.add(joints, _VERTICES),
        "WEIGHTS_0": file.add(weights, _VERTICES),
    }
    indices = file.add(mesh.faces.reshape(-1, 1).astype(np.uint16 if small else np.uint32), _INDICES)
    return {"name": "body", "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}


def _animation(motion: Motion, file: _Glb) -> dict[str, Any]:
    """Return the path of the root and the turns of the joints; those of joints that never turn are left out."""
    times = np.arange(motion.n_frames) / float(motion.grid.rate)
    clock = file.add(times[:, None].astype(np.float32), bounds=True)
    root = (motion.skeleton.offsets[0] + motion.translation).astype(np.float32)
    tracks = [(1, "translation", file.add(root))]
    for joint in range(motion.skeleton.n_joints):
        if motion.rotations[:, joint].any():
            tracks.append((1 + joint, "rotation", file.add(_quaternions(motion.rotations[:, joint]))))
    return {
        "name": "motion",
        "samplers": [{"input": clock, "interpolation": "LINEAR", "output": output} for *_, output in tracks],
        "channels": [
            {"sampler": number, "target": {"node": node, "path": path}}
            for number, (node, path, _) in enumerate(tracks)
        ],
        "extras": {"fps": str(motion.grid), "frames": motion.n_frames},
    }


def _quaternions(rotvecs: Float64Array) -> npt.NDArray[np.float32]:
    """Return unit quaternions (T, 4), real part last, each on the side of the sphere of the one before."""
    quaternions = rotation(rotvecs).as_quat()
    turned = np.einsum("tk,tk->t", quaternions[1:], quaternions[:-1]) < 0
    quaternions[1:][np.cumsum(turned) % 2 == 1] *= -1
    return np.asarray(quaternions, dtype=np.float32)


@dataclass
class _Glb:
    """The numbers of a file, with their accessors and views."""

    numbers: bytearray = field(default_factory=bytearray)
    accessors: list[dict[str, Any]] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)

    def add(self, array: Array, target: int | None = None, *, bounds: bool = False) -> int:
        """Add rows (N, K) and return the number of their accessor."""
        view = {"buffer": 0, "byteOffset": len(self.numbers), "byteLength": array.nbytes}
        self.views.append(view if target is None else {**view, "target": target})
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENTS[array.dtype.name],
            "count": len(array),
            "type": _TYPES[array.shape[1]],
        }
        if bounds:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.accessors.append(accessor)
        self.numbers += array.astype(array.dtype.newbyteorder("<")).tobytes()
        self.numbers += bytes(-len(self.numbers) % 4)
        return len(self.accessors) - 1

    def data(self, document: dict[str, Any]) -> bytes:
        """Return the file."""
        whole = {
            **document,
            "buffers": [{"byteLength": len(self.numbers)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
        }
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self.numbers)
        head = struct.pack("<5I", _MAGIC, _VERSION, size, len(text), _JSON_CHUNK)
        return head + text + struct.pack("<2I", len(self.numbers), _BIN_CHUNK) + bytes(self.numbers)
