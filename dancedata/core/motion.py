"""Motion: root translation and joint rotations over time, and where they place the joints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dancedata.core.arguments import require_finite
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array, FloatArray, matrix_from_rotvec, slerp
from dancedata.core.skeleton import Skeleton

#: Frames whose matrices are copied at a time.
_FRAMES = 256


def forward_kinematics(skeleton: Skeleton, rotations: FloatArray, translation: FloatArray) -> Float64Array:
    """Return joint positions.

    Parameters
    ----------
    skeleton
        J joints. The posed root is at offsets[0] + translation, as in SMPL (Loper et al. 2015).
    rotations
        (T, J, 3) axis-angle, radians, each relative to the parent.
    translation
        (T, 3) metres.

    Returns
    -------
    (T, J, 3) float64
        Positions in metres, in the axes of the input.
    """
    return joint_positions(skeleton, world_matrices(skeleton, matrix_from_rotvec(rotations)), translation)


def world_matrices(skeleton: Skeleton, local: Float64Array) -> Float64Array:
    """Return every joint's rotation in the world, (T, J, 3, 3), from those relative to the parents."""
    world = np.empty_like(local)
    world[:, 0] = local[:, 0]
    for joint in range(1, skeleton.n_joints):
        np.matmul(world[:, skeleton.parents[joint]], local[:, joint], out=world[:, joint])
    return world


def joint_positions(skeleton: Skeleton, world: Float64Array, translation: FloatArray) -> Float64Array:
    """Return joint positions (T, J, 3) from rotations in the world (T, J, 3, 3) and the root's translation (T, 3)."""
    return placed(skeleton, posed_bones(skeleton, world), translation)


def posed_bones(skeleton: Skeleton, world: Float64Array) -> Float64Array:
    """Return the vectors from each joint's parent to it, (J - 1, T, 3), without the root; rotations as above."""
    parents = list(skeleton.parents[1:])
    bones = np.empty((len(parents), len(world), 3), dtype=np.float64)
    for begin in range(0, len(world), _FRAMES):
        frames = slice(begin, begin + _FRAMES)
        # For matrices this small `@` takes four times as long.
        np.einsum("tjab,jb->jta", world[frames, parents], skeleton.offsets[1:], out=bones[:, frames])
    return bones


def placed(skeleton: Skeleton, bones: Float64Array, translation: FloatArray) -> Float64Array:
    """Return joint positions (T, J, 3) from `posed_bones` and the root's translation (T, 3)."""
    positions = np.empty((skeleton.n_joints, *translation.shape), dtype=np.float64)
    np.add(skeleton.offsets[0], translation, out=positions[0])
    for joint, bone in enumerate(bones, 1):
        np.add(positions[skeleton.parents[joint]], bone, out=positions[joint])
    return np.ascontiguousarray(positions.swapaxes(0, 1))


@dataclass(frozen=True, eq=False)
class _Poses:
    """Matrices and joint positions of a whole motion, computed once for it and its parts.

    `local`, `world`: Rotations (T, J, 3, 3), relative to the parents and in the world; None where they are not kept.
    `places`, `bones`: Joint positions (T, J, 3) for each requested skeleton, and `posed_bones` of different bones.
    """

    whole: Motion
    local: Float64Array | None = None
    world: Float64Array | None = None
    places: list[tuple[Skeleton, Float64Array]] = field(default_factory=list)
    bones: list[tuple[Skeleton, Float64Array]] = field(default_factory=list)

    @classmethod
    def of(cls, whole: Motion) -> _Poses:
        local = whole.matrices
        world = world_matrices(whole.skeleton, local)
        for array in (local, world):
            array.setflags(write=False)
        return cls(whole, local, world)

    def joints(self, skeleton: Skeleton) -> Float64Array:
        for posed, places in self.places:
            if posed is skeleton:
                return places
        places = placed(skeleton, self._bones(skeleton), self.whole.translation)
        self.places.append((skeleton, places))
        return places

    def _bones(self, skeleton: Skeleton) -> Float64Array:
        for posed, bones in self.bones:
            # Skeletons often differ in nothing but the root.
            if posed.parents == skeleton.parents and np.array_equal(posed.offsets[1:], skeleton.offsets[1:]):
                return bones
        world = self.world
        if world is None:
            world = world_matrices(self.whole.skeleton, self.whole.matrices)
        bones = posed_bones(skeleton, world)
        self.bones.append((skeleton, bones))
        return bones


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion in canonical form: metres, +Y up, radians, exact frame rate, read-only float64 arrays.

    Attributes
    ----------
    translation
        (T, 3) SMPL's translation, metres; the posed root is at skeleton.offsets[0] + translation.
    rotations
        (T, J, 3) axis-angle relative to the parent, radians; lengths beyond pi are allowed.
    grid
        Frame rate.
    skeleton
        J joints.
    trim_start
        First frame of the dance, if the dataset recommends to trim earlier ones (a dancer who waits). They are
        kept; windows skip them, and grounding uses this frame.
    stretch_m
        Largest change of a bone's length in the capture that this motion's rigid bones stand for, metres.
    fit_m
        Mean distance of the joints from the positions that the rotations were fitted to, metres; how bones turn
        about themselves is then unknown. None where rotations are the source's.

    Raises
    ------
    DataError
        "empty", "bad_shape" or "nan".

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.core.grid import FrameGrid
    >>> from dancedata.core.motion import Motion
    >>> from dancedata.core.skeleton import SMPL24
    >>> motion = Motion(np.zeros((60, 3)), np.zeros((60, 24, 3)), FrameGrid.of(30), SMPL24)
    >>> motion
    Motion(60 frames at 30 FPS, 2.00 s, skeleton smpl24)
    >>> motion.joints().shape
    (60, 24, 3)
    """

    translation: Float64Array
    rotations: Float64Array
    grid: FrameGrid
    skeleton: Skeleton
    trim_start: int = 0
    stretch_m: float = 0.0
    fit_m: float | None = None
    # The poses of a whole motion, and the slice of its frames. Not an argument of the constructor, so that
    # `dataclasses.replace` drops it.
    _poses: tuple[_Poses, slice] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        translation = np.array(self.translation, dtype=np.float64)
        rotations = np.array(self.rotations, dtype=np.float64)
        joints = self.skeleton.n_joints
        if rotations.ndim != 3 or rotations.shape[1:] != (joints, 3) or translation.shape != (len(rotations), 3):
            raise DataError("the shapes of translation and rotations do not match", reason="bad_shape",
                            found=f"translation {translation.shape}, rotations {rotations.shape}",
                            allowed=f"(T, 3) and (T, {joints}, 3) for skeleton {self.skeleton.name}")  # fmt: skip
        if len(rotations) == 0:
            raise DataError("the motion has no frames", reason="empty", found="0 frames")
        if not 0 <= self.trim_start < len(rotations):
            raise DataError("no frame of the motion is left after the trim", reason="too_short",
                            found=f"{len(rotations)} frames, {self.trim_start} of them to be trimmed")  # fmt: skip
        for what, array in (("translation", translation), ("rotations", rotations)):
            require_finite(array, what)
            array.setflags(write=False)
        object.__setattr__(self, "translation", translation)
        object.__setattr__(self, "rotations", rotations)

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.rotations)

    def __repr__(self) -> str:
        length = f"{self.n_frames} frames at {self.grid} FPS, {float(self.grid.seconds(self.n_frames)):.2f} s"
        trimmed = f", trim_start {self.trim_start}" if self.trim_start else ""
        return f"Motion({length}, skeleton {self.skeleton.name}{trimmed})"

    def part(self, start: int, stop: int) -> Motion:
        """Return frames start .. stop - 1. A part that ends before trim_start has a trim_start of 0."""
        trim = self.trim_start - start
        trim = trim if 0 < trim < min(stop, self.n_frames) - start else 0
        return self._frames(slice(start, stop), self.grid, trim)

    def _frames(self, frames: slice, grid: FrameGrid, trim_start: int) -> Motion:
        """Return a slice of the frames as views: they are checked, and read-only."""
        part = object.__new__(Motion)
        if self._poses is not None:
            poses, whole = self._poses
            indices = range(poses.whole.n_frames)[whole][frames]
            part.__dict__["_poses"] = poses, slice(indices.start, indices.stop, indices.step)
        part.__dict__.update(
            translation=self.translation[frames],
            rotations=self.rotations[frames],
            grid=grid,
            skeleton=self.skeleton,
            trim_start=trim_start,
            stretch_m=self.stretch_m,
            fit_m=self.fit_m,
        )
        if part.n_frames == 0:
            raise DataError("the motion has no frames", reason="empty", found="0 frames")
        return part

    def on(self, skeleton: Skeleton) -> Motion:
        """Return the same translation and rotations on another skeleton of as many joints."""
        return Motion(self.translation, self.rotations, self.grid, skeleton, self.trim_start)

    def with_cache(self, *, matrices: bool = True) -> Motion:
        """Return the same motion with matrices and joint positions cached for itself and all its parts.

        For motions with many overlapping parts to encode. The cache takes 144 bytes per joint and frame for matrices,
        which may be left out, and 24 to 48 for each requested skeleton.
        """
        motion = self._frames(slice(None), self.grid, self.trim_start)
        motion.__dict__["_poses"] = _Poses.of(self) if matrices else _Poses(self), slice(None)
        return motion

    @property
    def is_cached(self) -> bool:
        """Whether matrices and joint positions are cached, see `with_cache`."""
        return self._poses is not None

    @property
    def matrices(self) -> Float64Array:
        """Rotations (T, J, 3, 3) relative to the parents; read-only if they are cached."""
        local, frames = (None, slice(None)) if self._poses is None else (self._poses[0].local, self._poses[1])
        return matrix_from_rotvec(self.rotations) if local is None else local[frames]

    def resampled(self, grid: FrameGrid) -> Motion:
        """Return the motion at another rate, from the same first frame.

        An integer ratio keeps every n-th frame unchanged (60 -> 30 takes frames 0, 2, 4, ...). Otherwise rotations
        are interpolated by slerp and the translation linearly, at the times of the new frames, none of which is
        after the last frame of the source.
        """
        if grid == self.grid:
            return self
        step = self.grid.step_to(grid)
        if step is not None:
            trim = min(self.grid.rows_up(self.trim_start, of=grid), (self.n_frames - 1) // step)
            return self._frames(slice(None, None, step), grid, trim)
        n = self.grid.resampled_length(self.n_frames, grid)
        frames = self.grid.places(n, grid)
        lower = np.minimum(frames.astype(np.int64), max(self.n_frames - 2, 0))
        upper = np.minimum(lower + 1, self.n_frames - 1)
        share = (frames - lower)[:, None]
        translation = self.translation[lower] * (1 - share) + self.translation[upper] * share
        trim = min(self.grid.rows_up(self.trim_start, of=grid), n - 1)
        return Motion(translation, slerp(self.rotations, frames), grid, self.skeleton, trim)

    def joints(self, skeleton: Skeleton | None = None) -> Float64Array:
        """Return joint positions (T, J, 3), metres; `skeleton` gives other bones, with the same parents."""
        bones = skeleton or self.skeleton
        if self._poses is None:
            return joint_positions(bones, world_matrices(self.skeleton, self.matrices), self.translation)
        poses, frames = self._poses
        return poses.joints(bones)[frames].copy()
