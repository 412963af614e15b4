"""Input of metrics: joint positions at an exact rate, beats of music, and outcomes that are not numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import require_finite
from dancedata.core.columns import Columns
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array

IntArray = npt.NDArray[np.int64]

#: Why a metric has no value for a clip or a set, and what that means.
OUTCOMES = {
    "short": "the clip has too few frames",
    "still": "the dancer does not move, or the root never accelerates",
    "no_motion_beats": "the motion has no beat",
    "no_music_beats": "the music has no beat within the clip",
    "no_beats": "the motion or the music has no beat",
    "no_contact": "a foot never touches the ground",
    "few_clips": "the set has too few clips",
    "few_dancers": "the group has too few dancers",
    "no_duet": "the group is not of two dancers",
}


class Undefined(DataError):  # noqa: N818 (an outcome, which callers catch and count)
    """A metric has no value here: 0 / 0, no beat, too few frames. Such clips are set aside and counted by name.

    Parameters
    ----------
    outcome
        A key of `OUTCOMES`; it is also `reason`.
    """

    def __init__(self, outcome: str, *, found: object = None, allowed: object = None) -> None:
        super().__init__(
            f"the metric is undefined: {OUTCOMES[outcome]}", reason=outcome, found=found, allowed=allowed
        )


def checked_joints(joints: npt.ArrayLike) -> Float64Array:
    """Return joint positions (T, J, 3) as float64; DataError "bad_shape", "empty" or "nan"."""
    array = np.asarray(joints, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 3:
        raise DataError("invalid shape of joints", reason="bad_shape", found=f"{array.shape}", allowed="(T, J, 3)")
    if array.size == 0:
        raise DataError("the joints are empty", reason="empty", found=f"{array.shape}",
                        allowed="at least one frame and one joint")  # fmt: skip
    require_finite(array, "the array of joints")
    return array


def checked_group(joints: npt.ArrayLike, least: int = 1) -> Float64Array:
    """Return positions (P, T, J, 3) as float64, as `checked_joints`; Undefined "few_dancers" below `least`."""
    array = np.asarray(joints, dtype=np.float64)
    if array.ndim != 4:
        raise DataError(
            "invalid shape of a group's joints", reason="bad_shape", found=f"{array.shape}", allowed="(P, T, J, 3)"
        )
    if len(array) < least:
        raise Undefined("few_dancers", found=f"{len(array)}", allowed=f"at least {least}")
    return np.stack([checked_joints(dancer) for dancer in array])


def peak_offsets(curve: npt.ArrayLike, at: IntArray) -> Float64Array:
    """Return how far a curve's peak is from its indices `at`, -1/2 to 1/2, by parabolas; 0 at ends or without one."""
    values = np.asarray(curve, dtype=np.float64)
    before, value, after = (values[(at + k).clip(0, len(values) - 1)] for k in (-1, 0, 1))
    bend = before - 2 * value + after
    peaked = (at > 0) & (at < len(values) - 1) & (bend < 0)
    return np.where(peaked, (before - after) / np.where(peaked, 2 * bend, 1), 0).clip(-0.5, 0.5)


@dataclass(frozen=True, eq=False)
class MusicBeats:
    """Beats of music: frames of a grid that begins with the clip.

    Attributes
    ----------
    frames
        (B,) int64, ascending; may include beats after the clip's end.
    grid
        Rate of these frames.
    instants
        (B,) seconds from the first frame, where these are known better than by frames: some may lie before it.
        None: those of the frames.
    """

    frames: IntArray
    grid: FrameGrid
    instants: Float64Array | None = None

    @property
    def seconds(self) -> Float64Array:
        """Instants of the beats (B,), seconds from the first frame."""
        return self.frames / float(self.grid.rate) if self.instants is None else self.instants

    @classmethod
    def of_rows(cls, rows: npt.NDArray[Any], columns: Columns, grid: FrameGrid, *, late: int = 0) -> MusicBeats:
        """Return the beats of rows (T, D) of an audio feature: where its group "beat" is 1.

        The instant of a beat is that of its row minus `late` rows (`AudioFeature.beat_rows_late`). Where the feature
        has an onset envelope, the instant is that of the envelope's peak between the neighbouring rows.
        """
        frames = np.flatnonzero((rows[:, columns.slice("beat")] > 0.5).any(axis=1))
        places = frames.astype(np.float64) - late
        if "onset_envelope" in columns.names:
            places += peak_offsets(rows[:, columns.slice("onset_envelope")].ravel(), frames)
        return cls(frames, grid, places / float(grid.rate))

    @classmethod
    def of(cls, frames: Sequence[int] | npt.NDArray[Any], grid: FrameGrid) -> MusicBeats:
        """Make beats of whole numbers in any order; UsageError for others, or below 0."""
        numbers = np.asarray(frames)
        if numbers.size == 0:
            return cls(np.zeros(0, np.int64), grid)
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or int(numbers.min()) < 0:
            raise UsageError("beats are frame numbers", found=f"{numbers.dtype} of shape {numbers.shape}",
                             allowed="(B,) whole numbers of at least 0")  # fmt: skip
        return cls(np.sort(numbers.astype(np.int64)), grid)

    def after(self, start: int, grid: FrameGrid) -> MusicBeats:
        """Return the beats at or after frame `start` of `grid`, counted from there."""
        if grid.is_whole(start, of=self.grid):
            frames, rate = self.frames - grid.rows(start, of=self.grid), self.grid
        else:
            music, clip = self.grid.rate, grid.rate
            rate = FrameGrid(Fraction(music.numerator * clip.numerator))
            frames = self.frames * (music.denominator * clip.numerator) - start * clip.denominator * music.numerator
        instants = None if self.instants is None else self.instants[frames >= 0] - float(grid.seconds(start))
        return MusicBeats(frames[frames >= 0], rate, instants)


@dataclass(frozen=True, eq=False)
class Dance:
    """Joint positions of one clip, or of the dancers of a group, and the beats of its music.

    Attributes
    ----------
    joints
        (T, J, 3) float64, metres; of a group (P, T, J, 3), in one world. Checked and made read-only.
    grid
        Rate of the frames.
    music
        Beats of the music; None without music.
    """

    joints: Float64Array
    grid: FrameGrid
    music: MusicBeats | None = None

    def __post_init__(self) -> None:
        check = checked_group if np.ndim(self.joints) == 4 else checked_joints
        joints = check(self.joints).view()
        joints.setflags(write=False)
        object.__setattr__(self, "joints", joints)

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return int(self.joints.shape[-3])

    @property
    def fps(self) -> float:
        """Frames per second."""
        return float(self.grid.rate)

    def __repr__(self) -> str:
        beats = "no music" if self.music is None else f"{len(self.music.frames)} beats of music"
        return f"Dance({self.n_frames} frames at {self.grid} per second, {self.joints.shape[-2]} joints, {beats})"
