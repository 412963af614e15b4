"""Body models for the page that is served: sent once, to the browser of the same machine, never into a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.typing import override
from dancedata.formats.body_mesh import BodyMesh
from dancedata.scene.payload import packed
from dancedata.scene.scene_list import Item, Scene, SceneList


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
    def sliding(self, item: Item) -> float | None:
        return self.scenes.sliding(item)  # distances and speeds are those of the motion as it was read

    @override
    def flag_count(self, item: Item) -> int:
        return self.scenes.flag_count(item)

    @override
    def changed(self) -> bool:
        return self.scenes.changed()


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
