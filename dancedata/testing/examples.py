"""Motions, fields and signals for tests, the same at every call."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.bodies import has_body
from dancedata.core.columns import Columns
from dancedata.core.dance import Dance, MusicBeats
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Float32Array, Representation, SampleField
from dancedata.core.registry import CONTACTS, KEYMOTIONS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton

FPS = FrameGrid.of(30)


def random_motion(skeleton: Skeleton, n_frames: int, *, turn_rad: float = 2.5, step_m: float = 0.05) -> Motion:
    """Return a motion at 30 frames per second, the same at every call; by default with rotations beyond pi.

    Examples
    --------
    >>> from dancedata.core.skeleton import SMPL24
    >>> from dancedata.testing.examples import random_motion
    >>> random_motion(SMPL24, 60)
    Motion(60 frames at 30 FPS, 2.00 s, skeleton smpl24)
    """
    rng = np.random.default_rng(0)
    rotations = rng.normal(0, turn_rad, (n_frames, skeleton.n_joints, 3))
    return Motion(rng.normal(0, step_m, (n_frames, 3)).cumsum(axis=0), rotations, FPS, skeleton)


def mirrored_motion(motion: Motion) -> Motion:
    """Return the motion's reflection across x = 0."""
    order = np.arange(motion.skeleton.n_joints)
    for left, right in motion.skeleton.pairs:
        order[left], order[right] = right, left
    rotations = motion.rotations[:, order] * (1, -1, -1)  # an axis is a pseudovector
    return Motion(motion.translation * (-1, 1, 1), rotations, motion.grid, motion.skeleton, motion.trim_start)


def random_signal(seconds: float, sample_rate: int) -> AudioSignal:
    """Return two noise bursts per second over a tone, the same at every call.

    Examples
    --------
    >>> from dancedata.testing.examples import random_signal
    >>> random_signal(0.5, 48000)
    AudioSignal(24000 samples at 48000 Hz, 0.50 s)
    """
    rng = np.random.default_rng(0)
    time_s = np.arange(int(seconds * sample_rate)) / sample_rate
    bursts = rng.normal(0, 0.2, len(time_s)) * np.exp(-20 * (time_s % 0.5))
    return AudioSignal(np.asarray(bursts + 0.1 * np.sin(2 * np.pi * 220 * time_s), np.float32), sample_rate)


@dataclass(frozen=True)
class ExampleField:
    """A motion or key motion field with rows of it, and as augmentations of samples see it."""

    name: str
    kind: Literal["motion", "keymotion"]
    columns: Columns
    rows: Float32Array
    sample_field: SampleField


def example_fields() -> list[ExampleField]:
    """Return 40 rows of every registered representation and key motion finder."""
    motion = random_motion(SMPL24, 40, turn_rad=0.5)
    fields = []
    for name in REPRESENTATIONS.names():
        representation, rule = REPRESENTATIONS.get(name)(), contact_rule_of(REPRESENTATIONS.get(name)())
        grid = FPS if representation.rate is None else FrameGrid(representation.rate)
        sample_field = SampleField(name, "motion", representation.columns, grid, representation, rule)
        body = representation.skeleton
        rows = representation.encode(motion if has_body(body) else random_motion(body, 40, turn_rad=0.5), rule)
        fields.append(ExampleField(name, "motion", representation.columns, rows, sample_field))
    for name in KEYMOTIONS.names():
        finder = KEYMOTIONS.get(name)()
        sample_field = SampleField(name, "keymotion", finder.columns, FPS)
        fields.append(ExampleField(name, "keymotion", finder.columns, finder.analyse(motion), sample_field))
    return fields


def example_dances() -> list[Dance]:
    """Return short dances on SMPL's 24 joints with beats of music: ordinary ones, still, short and beatless ones."""
    from dancedata.synthetic import synthesise_motion

    grid = FrameGrid.of(60)
    names = ("gHO_sBM_cAll_d17_mHO1_ch01", "gJS_sBM_cAll_d25_mJS3_ch02", "gJS_sBM_cAll_d26_mJS3_ch01")
    joints = [synthesise_motion(name, n_frames=180)[0].joints() for name in names]
    beats = MusicBeats.of([12, 43, 75, 106, 138, 170], grid)
    ordinary = [Dance(positions, grid, beats) for positions in joints]
    still = Dance(np.repeat(joints[0][:1], 60, axis=0), grid, beats)
    short = [Dance(joints[0][:n], grid, beats) for n in (1, 2, 3)]
    return [*ordinary, still, *short, Dance(joints[0], grid, MusicBeats.of([], grid))]


def contact_rule_of(representation: Representation) -> ContactRule | None:
    """Return the contact rule of a representation where a recipe names none."""
    return None if representation.default_contacts is None else CONTACTS.get(representation.default_contacts)()
