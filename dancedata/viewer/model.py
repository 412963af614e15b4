"""Body models for the page that is served: sent once, to the browser of the same machine, never into a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.formats.body_mesh import BodyMesh
from dancedata.scene.payload import packed
from dancedata.scene.scene_list import Scene


def as_model(scene: Scene, mesh: BodyMesh | None) -> Scene:
    """Return a scene drawn as a body model where its rotations are known, else as it is, with a note."""
    try:
        return scene if mesh is None else scene.with_mesh(mesh)
    except UsageError as error:
        return replace(scene, notes=(*scene.notes, f"no body model: {error}"))


#: Largest number of a weight or of a share of a colour.
_WHOLE = 255


def model_payload(mesh: BodyMesh) -> list[tuple[str, str, str]]:
    """Return a body model for the page's shader, SMPL in 0.3 MB: name, type and bytes of each array.

    Vertices are in metres from the root, with normals; each has four joints, their weights of 255, and its shares of
    left and right, of 255. There are no pose correctives.
    """
    joints, weights = mesh.influences
    tint = np.zeros((len(joints), 4), dtype=np.uint8)
    tint[:, :2] = np.round(_WHOLE * mesh.sides[:, 1:])
    return [
        ("at", "Float32Array", packed((mesh.vertices - mesh.rest[0]).astype("<f4"))),
        ("normal", "Float32Array", packed(mesh.normals.astype("<f4"))),
        ("bones", "Uint8Array", packed(joints)),
        ("weights", "Uint8Array", packed(np.round(_WHOLE * weights).astype(np.uint8))),
        ("tint", "Uint8Array", packed(tint)),
        ("faces", "Uint32Array", packed(mesh.faces.astype("<u4"))),
    ]
