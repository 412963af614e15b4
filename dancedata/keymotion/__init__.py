"""Key motions: instants at which a dance comes to rest. `lodge` is a plug-in, the rest are pure functions."""

from dancedata.keymotion.characteristic_primitives import Primitives, borders, primitives
from dancedata.metrics.key_motion import KeyMotion, key_motion, kinetic_curve

__all__ = [
    "KeyMotion",
    "Primitives",
    "borders",
    "key_motion",
    "kinetic_curve",
    "primitives",
]
