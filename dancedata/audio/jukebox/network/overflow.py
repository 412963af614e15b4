"""The error for activations beyond the range of their type."""

from __future__ import annotations

from dancedata.core.errors import DanceDataError


class JukeboxOverflowError(DanceDataError):
    """An activation is not a finite number; the results must not be used."""


def overflow(layer: int, precision: str) -> JukeboxOverflowError:
    """Return the error for values that are not finite, at `layer` or before."""
    return JukeboxOverflowError(
        f"jukebox: activations up to layer {layer} are not finite",
        found=f"infinity or NaN, in precision {precision}",
        fix='start again with precision "bf16" (or "fp32") for all clips: a dataset should have one precision only'
        if precision == "fp16"
        else "check the weights: values within the range of float32 do not overflow in this precision",
    )
