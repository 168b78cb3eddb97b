"""The geometry of a camera: a pinhole, and where it stands to see all that it should."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.state import BoolArray, FloatArray

__all__ = ["NEAREST", "Lens", "aim"]

NEAREST = 0.05
"""Nothing nearer to the eye is drawn, m."""
_LEAST_WAY = 0.5  # The eye of a view is placed no nearer to a point than this, m


@dataclass(frozen=True)
class Lens:
    """A pinhole camera. World frame, m; pixels count from the upper left corner."""

    width: int  # Of the picture, pixels
    height: int  # Of the picture, pixels
    tangent: float  # Tangent of half the vertical field of view
    eye: FloatArray  # (3,) where the camera stands
    right: FloatArray  # (3,) unit vector to the right of the picture
    up: FloatArray  # (3,) unit vector to its top
    forward: FloatArray  # (3,) unit vector into it

    @property
    def focal(self) -> float:
        """Pixels that a length of 1 m has at a distance of 1 m."""
        return self.height / (2.0 * self.tangent)

    def depth(self, points: npt.ArrayLike) -> FloatArray:
        """Return the distances (...) of points (..., 3) before the camera, m."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.eye) @ self.forward)

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (..., 2), as (column, row), of points (..., 3) before the camera."""
        ray = np.asarray(points, dtype=np.float64) - self.eye
        scale = self.focal / (ray @ self.forward)
        column = self.width / 2 + scale * (ray @ self.right)
        row = self.height / 2 - scale * (ray @ self.up)
        return np.stack([column, row], axis=-1)

    def sees(self, points: npt.ArrayLike) -> BoolArray:
        """Return whether each of the points (..., 3) lies in the picture."""
        p = np.asarray(points, dtype=np.float64)
        before = self.depth(p) > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = np.moveaxis(self.project(p), -1, 0)
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        return np.asarray(before & inside)

    def rays(self) -> FloatArray:
        """Direction (height, width, 3) of the ray through the center of each pixel."""
        size = 2.0 * self.tangent / self.height
        columns = (np.arange(self.width) + 0.5 - self.width / 2) * size
        rows = (self.height / 2 - np.arange(self.height) - 0.5) * size
        across = columns[None, :, None] * self.right
        return np.asarray(across + rows[:, None, None] * self.up + self.forward)


def aim(
    points: npt.ArrayLike,
    width: int,
    height: int,
    azimuth_deg: float,
    elevation_deg: float,
    field_of_view_deg: float,
    margin_m: float,
) -> Lens:
    """Place a camera as near as possible to points (..., 3), m, with a margin around each.

    The azimuth is where it stands seen from the points, counter-clockwise from x; the field of view
    is vertical; width and height are pixels.
    """
    flat = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    target = (flat.min(axis=0) + flat.max(axis=0)) / 2
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    cosine = math.cos(elevation)
    back = np.array([cosine * math.cos(azimuth), cosine * math.sin(azimuth), math.sin(elevation)])
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.cross(back, right)
    tangent = math.tan(math.radians(field_of_view_deg) / 2)
    offset = flat - target
    # A point p is inside if |p . up| + margin <= tangent (distance - p . back), same to the side.
    beside = (np.abs(offset @ right) + margin_m) / (tangent * width / height)
    above = (np.abs(offset @ up) + margin_m) / tangent
    distance = float((np.maximum(np.maximum(beside, above), _LEAST_WAY) + offset @ back).max())
    return Lens(width, height, tangent, target + distance * back, right, up, -back)
