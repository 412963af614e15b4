"""Key motions: where a dance comes to rest for a moment. One file, one finder; and Lodge's primitives."""

from dancedata.core.choreography import PlacedCues, choreographic_augmentation
from dancedata.core.key_motion import KeyMotion, key_motion, kinetic_curve
from dancedata.core.primitives import Primitives, borders, primitives

__all__ = [
    "KeyMotion",
    "PlacedCues",
    "Primitives",
    "borders",
    "choreographic_augmentation",
    "key_motion",
    "kinetic_curve",
    "primitives",
]
