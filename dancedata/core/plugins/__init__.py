"""The kinds of plug-ins: one abstract base class for each, with defaults for everything that is optional.

A plug-in is a frozen dataclass, derived from one of these classes and registered under a name. Its fields are the
keys that a recipe may set. It has to define the abstract members, and may replace the others. A kind is loaded when
its class is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "PRIMITIVES",
    "AudioFeature",
    "Augmentation",
    "Better",
    "ContactRule",
    "CopyAugmentation",
    "Dataset",
    "FileFeature",
    "FileSpan",
    "Float32Array",
    "KeyMotionFinder",
    "Metric",
    "Plugin",
    "PrimitiveFinder",
    "Representation",
    "SampleAugmentation",
    "SampleField",
    "WindowFilter",
]

if TYPE_CHECKING:
    from dancedata.core.plugins.audio_feature import AudioFeature
    from dancedata.core.plugins.augmentation import Augmentation, CopyAugmentation, SampleAugmentation
    from dancedata.core.plugins.dataset import Dataset
    from dancedata.core.plugins.file_feature import FileFeature, FileSpan
    from dancedata.core.plugins.finders import PRIMITIVES, KeyMotionFinder, PrimitiveFinder, WindowFilter
    from dancedata.core.plugins.metric import Better, Metric
    from dancedata.core.plugins.plugin import Float32Array, Plugin
    from dancedata.core.plugins.representation import ContactRule, Representation, SampleField
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "core.plugins.audio_feature": "AudioFeature",
            "core.plugins.augmentation": "Augmentation CopyAugmentation SampleAugmentation",
            "core.plugins.dataset": "Dataset",
            "core.plugins.file_feature": "FileFeature FileSpan",
            "core.plugins.finders": "KeyMotionFinder PRIMITIVES PrimitiveFinder WindowFilter",
            "core.plugins.metric": "Better Metric",
            "core.plugins.plugin": "Float32Array Plugin",
            "core.plugins.representation": "ContactRule Representation SampleField",
        },
    )
