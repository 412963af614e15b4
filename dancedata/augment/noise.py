"""Noise on the angles of the joints."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from dancedata.augment._parameters import require_number, require_seed
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import CopyAugmentation, Float32Array, Representation, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.rotations import Float64Array, rotation
from dancedata.core.typing import override


@AUGMENTATIONS.register("noise")
@dataclass(frozen=True)
class JointNoise(CopyAugmentation, SampleAugmentation):
    """Small random turns of every joint except the root, smooth in time; contacts are labelled again.

    Each joint R becomes R exp(n), where the vector n has a normal distribution at knots every `every_s` seconds and
    is linear between them: independent noise in every frame would shake the feet faster than any contact rule allows.
    It is a function of time, the same for fields of different rates. The root is left alone, so that the dancer
    neither turns nor tilts.

    Copies work for every representation. Samples have to be decoded, changed and encoded again: representations of
    positions alone have no angles and are refused, as are key motions, which follow from the whole clip. Contacts of
    a sample are labelled within its window, on the representation's own bones.

    Attributes
    ----------
    std_degrees
        Standard deviation of each of the three components of the noise at the knots.
    every_s
        Seconds between knots.
    seed
        Seed of the copies: what is drawn for each is a pure function of (seed, clip id).
    """

    acts_on: ClassVar[Literal["world", "body"]] = "body"

    std_degrees: float = 2.0
    every_s: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("noise: std_degrees", self.std_degrees, 0, 90, "degrees")
        require_number("noise: every_s", self.every_s, 0.01, 3600, "seconds")
        require_seed(self.seed)

    @override
    def change_motion(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        return self._noisy(motion, Draw.of_clip(self.seed, clip))

    @override
    def check_sample(self, field: SampleField) -> None:
        if field.kind == "keymotion":
            raise UsageError(
                "key motions follow from the joints of the whole clip, and cannot be found again in a window",
                fix="leave the field out, or store copies: augment: {noise: {}} in a recipe",
            )
        if field.kind == "motion":
            _decodable(field)

    @override
    def change_sample(
        self, rows: Float32Array, field: SampleField, draw: Draw, about: Float64Array | None = None
    ) -> Float32Array:
        if not self.std_degrees:
            return rows
        representation = _decodable(field)
        motion = self._noisy(representation.decode(rows, field.grid), draw).with_cache()
        return representation.reencode(motion, field.contacts)

    @override
    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        """Return bounds that hold for any angles of the joints except the root, and for any contacts, only."""
        low, high = low.copy(), high.copy()
        for name in field.columns.names if self.std_degrees else ():
            part = field.columns.slice(name)
            if name.startswith("rotation"):
                root = (part.stop - part.start) // _decodable(field).skeleton.n_joints
                part, bound = slice(part.start + root, part.stop), -1.0
            elif name == "contact":
                bound = 0.0
            else:
                continue
            low[part], high[part] = np.minimum(low[part], bound), np.maximum(high[part], 1)
        return low, high

    def _noisy(self, motion: Motion, draw: Draw) -> Motion:
        joints = motion.skeleton.n_joints
        turns = _draw_smooth(draw, joints - 1, motion.n_frames, motion.grid, self.every_s)
        turns *= math.radians(self.std_degrees)
        rotations = motion.rotations.copy()
        rotations[:, 1:] = (rotation(rotations[:, 1:]) * rotation(turns)).as_rotvec()
        return replace(motion, rotations=rotations)


def _draw_smooth(draw: Draw, n_joints: int, n_frames: int, grid: FrameGrid, every_s: float) -> Float64Array:
    """Return vectors (T, J, 3): standard normal at knots every `every_s` seconds, linear between them."""
    n_knots = math.ceil(float(grid.seconds(n_frames)) / every_s) + 1
    knots = draw.normal(n_joints, n_knots, 3)
    at = np.arange(n_frames) / float(grid.rate) / every_s
    lower = np.minimum(at.astype(np.int64), n_knots - 2)
    share = (at - lower)[:, None]
    vectors = knots[:, lower] * (1 - share) + knots[:, lower + 1] * share
    return np.ascontiguousarray(vectors.swapaxes(0, 1))


def _decodable(field: SampleField) -> Representation:
    representation = field.representation
    if representation is None:
        raise UsageError("its representation is unknown, and so are the columns that are angles",
                         fix="read a dataset that a recipe of this installation built")  # fmt: skip
    if not representation.decodes:
        raise UsageError(f"the columns of {representation.name} do not determine the angles of the joints",
                         fix="leave the field out, or store copies: augment: {noise: {}} in a recipe")  # fmt: skip
    if representation.spatial is not None and representation.spatial.placeless and not representation.positions_only:
        raise UsageError(
            f"a window of {representation.name} begins with the way from the frame before, which decoding loses",
            fix="leave the field out, or store copies: augment: {noise: {}} in a recipe",
        )
    if representation.grounded and type(representation).reencode is Representation.reencode:
        raise UsageError(
            f"motion decoded from {representation.name} loses its height above the floor if encoded again",
            fix="define `reencode` in its class, or store copies: augment: {noise: {}} in a recipe",
        )
    return representation
