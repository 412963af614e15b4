"""Body models for the page that is served: sent once, to the browser of the same machine, never into a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.typing import override
from dancedata.formats.body_mesh import BodyMesh
from dancedata.viewer.payload import packed
from dancedata.viewer.scene_list import Item, Scene, SceneList


class ModelScenes(SceneList):
    """The items of another list, drawn as a body model where their rotations are known, else as they are."""

    def __init__(self, scenes: SceneList, mesh: BodyMesh) -> None:
        self.scenes, self.mesh = scenes, mesh
        self.place, self.grid, self.body, self.fields = scenes.place, scenes.grid, scenes.body, scenes.fields

    @property
    @override
    def items(self) -> Sequence[Item]:
        return self.scenes.items

    @override
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        scene = self.scenes.scene(item, field, first_s=first_s)
        try:
            return scene if self.mesh is None else scene.with_mesh(self.mesh)
        except UsageError as error:
            return replace(scene, notes=(*scene.notes, f"no body model: {error}"))

    @override
    def about(self) -> dict[str, Any]:
        return self.scenes.about()

    @override
    def windows_of(self, item: Item) -> tuple[tuple[int, int], ...]:
        return self.scenes.windows_of(item)

    @override
    def flag_count(self, item: Item) -> int:
        return self.scenes.flag_count(item)

    @override
    def changed(self) -> bool:
        return self.scenes.changed()


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
