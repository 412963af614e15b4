"""Body models for the page that is served: sent once, to the browser of the same machine, never into a file."""

from __future__ import annotations

from typing import Any

import numpy as np

from dancedata.formats.body_mesh import BodyMesh
from dancedata.viewer.payload import packed

#: Largest number of a weight or of a share of a colour.
_WHOLE = 255


def model_payload(mesh: BodyMesh) -> dict[str, Any]:
    """Return a body model for the page's shader: 180 kB of SMPL, 280 of SMPL-X, before they are packed.

    Vertices are from the root, whole numbers of `unit` metres (below 0.1 mm); each has four joints with weights of
    255, and its shares of left and right, of 255. There are no pose correctives.
    """
    places = mesh.vertices - mesh.rest[0].astype(np.float32)
    unit = float(np.abs(places).max()) / np.iinfo(np.int16).max
    joints, weights = mesh.influences
    tint = np.zeros((len(places), 4), dtype=np.uint8)
    tint[:, :2] = np.round(_WHOLE * mesh.sides[:, 1:])
    wide = len(places) > np.iinfo(np.uint16).max
    return {
        "unit": unit,
        "at": packed(np.round(places / unit).astype("<i2")),
        "bones": packed(joints),
        "weights": packed(np.round(_WHOLE * weights).astype(np.uint8)),
        "tint": packed(tint),
        "faces": packed(mesh.faces.astype("<u4" if wide else "<u2")),
        "wide": wide,
    }
