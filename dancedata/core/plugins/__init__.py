"""The kinds of plug-ins: one abstract base class for each, with defaults for everything that is optional.

A plug-in is a frozen dataclass, derived from one of these classes and registered under a name. Its fields are the
keys that a recipe may set. It has to define the abstract members, and may replace the others.
"""

from __future__ import annotations

from dancedata.core.plugins.audio_feature import AudioFeature, FileFeature, Placed
from dancedata.core.plugins.augmentation import Augmentation, CopyAugmentation, SampleAugmentation, SampleField
from dancedata.core.plugins.metric import Better, Metric
from dancedata.core.plugins.motion import (
    PRIMITIVES,
    ContactRule,
    Dataset,
    KeyMotionFinder,
    PrimitiveFinder,
    Representation,
    WindowFilter,
)
from dancedata.core.plugins.plugin import Float32Array, Plugin

__all__ = [
    "PRIMITIVES",
    "AudioFeature",
    "Augmentation",
    "Better",
    "ContactRule",
    "CopyAugmentation",
    "Dataset",
    "FileFeature",
    "Float32Array",
    "KeyMotionFinder",
    "Metric",
    "Placed",
    "Plugin",
    "PrimitiveFinder",
    "Representation",
    "SampleAugmentation",
    "SampleField",
    "WindowFilter",
]
