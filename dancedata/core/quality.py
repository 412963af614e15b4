"""Quality flags: what looks wrong in a motion. It is flagged, never repaired."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.rotations import angles_between

#: Faster than any joint of a dancer: 45 degrees in a frame at 60 FPS.
MAX_TURN_DEG_S = 2700.0
#: Faster than any dancer's pelvis.
MAX_ROOT_SPEED_M_S = 12.0


@dataclass(frozen=True)
class Flag:
    """Something suspicious between `frame` and the next one, at the source's frame rate.

    Attributes
    ----------
    kind
        "fast_turn": value is an angle, degrees. "root_jump": value is a distance, metres.
    rate
        Frames a second of `frame`, as text.
    """

    kind: str
    joint: str
    frame: int
    value: float
    unit: str
    rate: str

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__}


def quality_flags(
    motion: Motion, max_turn_deg_s: float = MAX_TURN_DEG_S, max_root_speed_m_s: float = MAX_ROOT_SPEED_M_S
) -> list[Flag]:
    """Find joints that turn, and roots that move, faster than a dancer can; ordered by frame, then joint."""
    if motion.n_frames < 2:
        return []
    rate = float(motion.grid.rate)
    angles = np.degrees(angles_between(motion.rotations))
    flags = [
        Flag("fast_turn", motion.skeleton.joints[j], int(t), round(float(angles[t, j]), 3), "deg", str(motion.grid))
        for t, j in np.argwhere(angles * rate > max_turn_deg_s)
    ]
    steps = np.linalg.norm(np.diff(motion.translation, axis=0), axis=1)
    root = motion.skeleton.joints[0]
    flags += [
        Flag("root_jump", root, int(t), round(float(steps[t]), 4), "m", str(motion.grid))
        for t in np.flatnonzero(steps * rate > max_root_speed_m_s)
    ]
    return sorted(flags, key=lambda f: (f.frame, f.kind, f.joint))
