"""The geometry of a pinhole camera, and its placement so that points are in the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.state import BoolArray, FloatArray

__all__ = ["NEAREST", "Lens", "aim"]

NEAREST = 0.05
"""Smallest distance from the camera at which objects are drawn, m."""
_LEAST_DISTANCE = 0.5  # Smallest distance at which the camera is placed from a point, m


@dataclass(frozen=True)
class Lens:
    """A pinhole camera. World frame, m; pixels count from the upper left corner."""

    width: int  # Width of the picture, pixels
    height: int  # Height of the picture, pixels
    tangent: float  # Tangent of half the vertical field of view
    eye: FloatArray  # (3,) position of the camera
    right: FloatArray  # (3,) unit vector to the right of the picture
    up: FloatArray  # (3,) unit vector to its top
    forward: FloatArray  # (3,) unit vector into it

    @property
    def focal(self) -> float:
        """The focal length in pixels: the size of 1 m at a distance of 1 m."""
        return self.height / (2.0 * self.tangent)

    def depth(self, points: npt.ArrayLike) -> FloatArray:
        """Return the depths (...) of points (..., 3) in front of the camera, m."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.eye) @ self.forward)

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Return pixels (..., 2), as (column, row), of points (..., 3) in front of the camera."""
        ray = np.asarray(points, dtype=np.float64) - self.eye
        scale = self.focal / (ray @ self.forward)
        column = self.width / 2 + scale * (ray @ self.right)
        row = self.height / 2 - scale * (ray @ self.up)
        return np.stack([column, row], axis=-1)

    def sees(self, points: npt.ArrayLike) -> BoolArray:
        """Return True for each of the points (..., 3) that is in the picture."""
        p = np.asarray(points, dtype=np.float64)
        before = self.depth(p) > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = np.moveaxis(self.project(p), -1, 0)
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        return np.asarray(before & inside)

    def rays(self) -> FloatArray:
        """Return the direction (height, width, 3) of the ray through the center of each pixel."""
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

    The azimuth is the direction from the points to the camera, counter-clockwise from x; the field
    of view is vertical; width and height are in pixels.
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
    # A point p is inside if |p . up| + margin <= tangent (distance - p . back); likewise `right`.
    beside = (np.abs(offset @ right) + margin_m) / (tangent * width / height)
    above = (np.abs(offset @ up) + margin_m) / tangent
    distance = float((np.maximum(np.maximum(beside, above), _LEAST_DISTANCE) + offset @ back).max())
    return Lens(width, height, tangent, target + distance * back, right, up, -back)
