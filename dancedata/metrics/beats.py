"""Beats of a dance, and how well they meet the beats of the music."""

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import Dance, MusicBeats, Undefined, checked_joints, peak_offsets
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override
from dancedata.metrics.arguments import IntArray, checked_rate, first_joints, known_name
from dancedata.metrics.key_motion import kinetic_curve, local_minima, smoothed
from dancedata.metrics.root import STEADY_FPS, steady

Cut = Literal["frames", "steps", "none"]
Numbers = IntArray | Float64Array


@dataclass(frozen=True)
class BeatDetector:
    """A way to find the beats of a motion: minima of its speed.

    - `curve`: "mean": the mean over joints of the step t -> t + 1, T - 1 values. "sum": the sum over joints of the
      step t - 1 -> t in float32, T values, the first 0, so that no beat is at `order` or before.
    - `sigma_frames`, `sigma_s`: Of the Gaussian that smooths the curve, in frames at any rate or in seconds.
    - `order`: Neighbours on each side that a minimum has to be below.
    """

    source: str
    curve: Literal["mean", "sum"]
    sigma_frames: float | None = None
    sigma_s: Fraction | None = None
    order: int = 1

    def __call__(self, joints: Float64Array, fps: float) -> IntArray:
        """Return the frames of the beats, ascending."""
        if self.curve == "sum":
            return local_minima(summed_steps(joints), self.order)
        curve = kinetic_curve(joints)
        sigma = self.sigma_frames if self.sigma_s is None else float(self.sigma_s) * checked_rate(fps)
        return local_minima(curve if sigma is None else smoothed(curve, sigma), self.order)


#: Detector of `motion_beat_times`.
INSTANTS = "instants"
#: Of the Gaussian that smooths its speed, seconds: Bailando's 5 frames at 60 per second.
_SIGMA_S = 1 / 12
#: Least rise of the speed on both sides of a beat, m/s, a mean over joints: rounding and float32 do not.
_DEPTH_M_S = 0.0001
#: Nearer to an end of a clip, the Gaussian reaches beyond it, and a beat of the motion may not be found, seconds.
_MARGIN_S = 2 * _SIGMA_S

#: By name. "seconds" is Bailando's with its Gaussian in seconds (Motius).
DETECTORS = {
    "seconds": BeatDetector(
        "Bailando's, its 5 frames at 60 per second taken as 1/12 s", "mean", sigma_s=Fraction(1, 12)
    ),
    "bailando": BeatDetector(
        "lisiyao21/Bailando cc90b98b, utils/beat_align_score.py; Lodge, DGSDP, MEGADance", "mean", sigma_frames=5
    ),
    "fact": BeatDetector("liruilong940607/mint d40065a, tools/calculate_beat_scores.py; POPDG", "sum", order=10),
    "gcd": BeatDetector("aioz-ai/GCD b9524d8, eval/calculate_beat_scores.py", "sum", order=5),
}


def summed_steps(joints: Float64Array) -> npt.NDArray[np.float32]:
    """Return FACT's curve (T,) float32: the sum over joints of the step to each frame; 0 for frame 0."""
    positions = checked_joints(joints).astype(np.float32)
    curve = np.zeros(len(positions), dtype=np.float32)
    curve[1:] = np.linalg.norm(np.diff(positions, axis=0), axis=2).sum(axis=1)
    return curve


def motion_beats(joints: Float64Array, fps: float, *, detector: str = "seconds") -> IntArray:
    """Return the beats of a motion: frames in which it is slowest.

    Index t of "seconds" and "bailando" is the step from frame t to t + 1, so the instant is t + 1/2.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres.
    fps
        Frames per second; only "seconds" depends on it.
    detector
        A key of `DETECTORS`.

    Returns
    -------
    (B,) int64
        Ascending; empty for a motion without beats.

    Examples
    --------
    >>> from dancedata.metrics import motion_beats
    >>> from dancedata.synthetic import synthesise_motion
    >>> joints = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0].joints()
    >>> motion_beats(joints, 60).tolist()
    [13, 59, 104]
    """
    known_name("detector", detector, DETECTORS)
    return DETECTORS[detector](joints, fps)


def motion_beat_times(joints: Float64Array, fps: float) -> Float64Array:
    """Return the beats of a motion in seconds: the instants, between frames too, at which it is slowest.

    The speed is a mean over joints of `steady` positions, smoothed by a Gaussian of 1/12 s. A beat is a minimum
    from which it rises by 0.1 mm/s on both sides, at the vertex of a parabola; equal neighbours are one beat, in the
    middle. The same motion at 20 to 60 frames per second has the same beats, mostly within 5 ms.

    Parameters
    ----------
    joints, fps
        (T, J, 3) positions, metres, and their frames per second.

    Returns
    -------
    (B,) float64
        Seconds from the first frame, ascending; empty for a motion without beats.

    Examples
    --------
    >>> from dancedata.metrics import motion_beat_times
    >>> from dancedata.synthetic import synthesise_motion
    >>> joints = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0].joints()
    >>> motion_beat_times(joints, 60).round(2).tolist()
    [0.22, 1.0, 1.74]
    """
    from scipy.signal import find_peaks

    curve = smoothed(kinetic_curve(steady(joints, fps)) * STEADY_FPS, _SIGMA_S * STEADY_FPS)
    slow = -np.round(curve, 9)  # a pause is exactly even
    lows, shape = find_peaks(slow, plateau_size=1, prominence=_DEPTH_M_S)
    first, last = shape["left_edges"], shape["right_edges"]
    places = (first + last) / 2 + np.where(first == last, peak_offsets(slow, lows), 0)
    # Value t of the curve is the step from t to t + 1.
    return np.asarray((places + 0.5) / STEADY_FPS, dtype=np.float64)


def nearest_offsets(points: Numbers, to: Numbers) -> Float64Array:
    """Return the difference (A,) of each point from the nearest of `to` (B,), below 0 where it comes before it."""
    targets = np.sort(np.asarray(to, dtype=np.float64))
    values = np.asarray(points, dtype=np.float64)
    right = np.searchsorted(targets, values).clip(0, len(targets) - 1)
    after, before = values - targets[right], values - targets[(right - 1).clip(0)]
    return np.asarray(np.where(np.abs(after) < np.abs(before), after, before))


def _kernel(points: Numbers, to: Numbers, sigma: float) -> Float64Array:
    if not (np.isfinite(sigma) and sigma > 0):
        raise UsageError("sigma must be above 0", found=sigma)
    return np.asarray(np.exp(-(nearest_offsets(points, to) ** 2) / (2 * sigma**2)))


def beat_alignment(from_: Numbers, to: Numbers, *, sigma: float) -> float:
    """Return the mean over `from_` of exp(-d^2 / (2 sigma^2)), d the distance to the nearest of `to`.

    The direction is the protocol's: FACT goes from the motion to the music, Bailando from the music to the motion.

    Parameters
    ----------
    from_, to
        (A,), (B,) beats, all in frames of one rate or all in seconds.
    sigma
        In the same unit.

    Returns
    -------
    float
        0 to 1; compare it with `chance_level`.

    Raises
    ------
    Undefined
        "no_beats": one of them is empty.

    Examples
    --------
    >>> from dancedata.metrics import beat_alignment
    >>> beat_alignment([0.5, 1.0, 1.5], [0.5, 1.0, 1.5], sigma=0.1)
    1.0
    >>> round(beat_alignment([0.6, 1.1, 1.6], [0.5, 1.0, 1.5], sigma=0.1), 3)
    0.607
    """
    if not len(from_) or not len(to):
        raise Undefined("no_beats", found=f"{len(from_)} and {len(to)} beats")
    return float(_kernel(from_, to, sigma).mean())


def chance_level(to: Numbers, end: float, *, sigma: float, step: float = 1.0) -> float:
    """Return the score of beats that are shifted at random within a clip, which depends on `to` alone.

    It is the mean of the kernel over the instants 0, step, 2 step, ... before `end`, which is the mean over all
    circular shifts of the other beats.

    Parameters
    ----------
    to
        (B,) the beats that the nearest is taken of.
    end
        Length of the clip, in the unit of the beats.
    sigma
        As `beat_alignment`.
    step
        Duration of a frame in that unit.

    Raises
    ------
    Undefined
        "no_beats" or "short".
    """
    if not len(to):
        raise Undefined("no_beats", found="0 beats")
    n = round(end / step)
    if n < 1:
        raise Undefined("short", found=f"a length of {end}")
    return float(_kernel(np.linspace(0, n * step, n, endpoint=False), to, sigma).mean())


def cut_beats(music: MusicBeats, n_frames: int, grid: FrameGrid, cut: Cut) -> IntArray:
    """Return the beats before the end of a clip of T frames: before frame T, before the last frame, or all."""
    if cut == "none":
        return music.frames
    end = grid.rows_up(n_frames if cut == "frames" else n_frames - 1, of=music.grid)
    return np.asarray(music.frames[music.frames < end])


@METRICS.register("beat_alignment")
@dataclass(frozen=True)
class BeatAlignment(Metric):
    """Beat alignment score, BAS (BA, Beat Align), with its chance level.

    Attributes
    ----------
    detector
        Detector of the motion's beats: "instants", in seconds (`motion_beat_times`), against the instants of the
        music; or a key of `DETECTORS`, whose frames are compared with the music's as programs do it.
    direction
        Which beats the mean is over: of the "music" (to the nearest of the motion), or of the "motion".
    sigma
        Width of the kernel.
    unit
        Unit of sigma: "s", or "frames" of the clip; then the beats of the music have to be at the clip's rate.
    cut
        Beats of the music that count: those within the T "frames", within the T - 1 "steps", or "none" is cut. Of
        "instants" those count that are at least 1/6 s from both ends, where the other beats are found.
    no_motion_beats
        A clip whose motion has no beat is undefined and set "aside", or has the score "zero".
    no_music_beats
        The same of its music.
    joints
        The first joints of the clip that are measured.
    clips
        What the sum over clips is divided by; 0: their number. POPDG divides by 24.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "Li et al. 2021, AI Choreographer, 5.2.2; Siyao et al. 2022, Bailando, 4.1"
    needs_music: ClassVar[bool] = True
    better: ClassVar[dict[str, Better]] = {"bas": "closer"}
    bounds: ClassVar[tuple[float, float]] = (0, 1)

    detector: str = INSTANTS
    direction: Literal["music", "motion"] = "music"
    sigma: float = 0.05
    unit: Literal["s", "frames"] = "s"
    cut: Cut = "steps"
    no_motion_beats: Literal["aside", "zero"] = "aside"
    no_music_beats: Literal["aside", "zero"] = "aside"
    joints: int = 24
    clips: int = 0

    def __post_init__(self) -> None:
        known_name("detector", self.detector, (INSTANTS, *DETECTORS))
        if self.needs_instants and self.unit != "s":
            raise UsageError("beats at their instants are in seconds", found=f"unit {self.unit!r}",
                             fix='take unit="s"')  # fmt: skip
        if not (np.isfinite(self.sigma) and self.sigma > 0):
            raise UsageError("sigma must be above 0", found=self.sigma)

    @property
    def needs_instants(self) -> bool:
        """Whether beats are compared at their instants."""
        return self.detector == INSTANTS

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return ("bas", "bas_chance")

    @override
    def measure(self, dance: Dance) -> Float64Array:
        motion, music, end, step = self._beats(dance)
        if not len(motion) and self.no_motion_beats == "aside":
            raise Undefined("no_motion_beats")
        if not len(music) and self.no_music_beats == "aside":
            raise Undefined("no_music_beats")
        if not len(motion) or not len(music):
            return np.zeros(2)
        from_, to = (music, motion) if self.direction == "music" else (motion, music)
        score = beat_alignment(from_, to, sigma=self.sigma)
        return np.array([score, chance_level(to, end, sigma=self.sigma, step=step)])

    def _beats(self, dance: Dance) -> tuple[Float64Array, Float64Array, float, float]:
        """Return beats of motion and music, the length that they are within and a step, in the unit of sigma."""
        if dance.music is None:
            raise UsageError("beat alignment needs the beats of the music", found="a clip without music")
        positions = first_joints(dance.joints, self.joints)
        if self.needs_instants:
            # Of the beats that the mean is over, those count whose neighbours can be found.
            length = (dance.n_frames - 1) / dance.fps - 2 * _MARGIN_S
            motion, beats = motion_beat_times(positions, dance.fps) - _MARGIN_S, dance.music.seconds - _MARGIN_S
            if self.direction == "music":
                beats = beats[(beats >= 0) & (beats <= length)]
            else:
                motion = motion[(motion >= 0) & (motion <= length)]
            return motion, beats, length, 1 / STEADY_FPS
        motion = motion_beats(positions, dance.fps, detector=self.detector).astype(np.float64)
        music = cut_beats(dance.music, dance.n_frames, dance.grid, self.cut).astype(np.float64)
        if self.unit == "s":
            step = 1 / dance.fps
            return motion / dance.fps, music / float(dance.music.grid.rate), dance.n_frames * step, step
        if dance.music.grid != dance.grid:
            raise UsageError("sigma is in frames, so the beats of the music have to be at the clip's rate",
                             found=f"beats at {dance.music.grid} per second, motion at {dance.grid}",
                             fix='take unit="s"')  # fmt: skip
        return motion, music, float(dance.n_frames), 1.0

    @override
    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        scores = super().summarise(rows, pool)
        if self.clips:
            scores["bas"] *= len(rows) / self.clips
        return scores
