"""Samples in a training loop: numbers, and pages of dances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["LightningSamples", "SampleLog", "Validation"]

if TYPE_CHECKING:
    from dancedata.training.lightning_callback import LightningSamples
    from dancedata.training.sample_log import SampleLog, Validation
else:
    __getattr__, __dir__ = lazy_names(
        __name__, {"training.lightning_callback": "LightningSamples", "training.sample_log": "SampleLog Validation"}
    )
