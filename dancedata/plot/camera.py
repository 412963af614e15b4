"""A camera that looks at the dancer: places in the room become places in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dancedata.core.rotations import Float64Array

__all__ = ["Camera"]

#: Turn about the vertical axis and downward tilt, radians; height of the point looked at above the floor, metres.
_YAW, _PITCH, _LOOK_AT = 0.55, 0.2, 0.85
#: Focal length in heights of the picture; distance for a picture of that height, metres.
_FOCAL, _DISTANCE = 1.25, 3.9
#: Nearest distance that is drawn.
_NEAREST = 0.1


@dataclass(frozen=True)
class Camera:
    """A perspective camera.

    Attributes
    ----------
    width, height
        Of the picture, pixels.
    target
        (x, floor, z) of the point on the floor below the point looked at, metres.
    """

    width: int
    height: int
    target: tuple[float, float, float]

    @property
    def tilt(self) -> float:
        """How flat a circle on the floor looks: height divided by width."""
        return float(np.sin(_PITCH))

    def __call__(self, places: Float64Array) -> Float64Array:
        """Return places (..., 3), metres, as (..., 3): pixels right and down, and pixels per metre there.

        Places behind the camera are NaN.
        """
        x, y, z = np.moveaxis(places - np.asarray(self.target), -1, 0)
        y = y - _LOOK_AT
        across = x * np.cos(_YAW) - z * np.sin(_YAW)
        along = x * np.sin(_YAW) + z * np.cos(_YAW)
        up = y * np.cos(_PITCH) - along * np.sin(_PITCH)
        near = y * np.sin(_PITCH) + along * np.cos(_PITCH)
        # A narrow picture shows the dancer from farther away.
        away = _DISTANCE * max(1.0, 1.1 * self.height / self.width) - near
        scale = np.where(away > _NEAREST, _FOCAL * self.height / np.where(away > _NEAREST, away, 1.0), np.nan)
        return np.stack([self.width / 2 + across * scale, self.height / 2 - up * scale, scale], axis=-1)
