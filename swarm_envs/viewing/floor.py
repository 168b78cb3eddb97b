"""The background of a picture: a floor with a grid, the sky, and soft shadows of drones."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.viewing.lens import Lens

__all__ = ["Backdrop"]

_ZENITH = np.array([206.0, 220.0, 235.0])
_HORIZON = np.array([246.0, 248.0, 250.0])
_FLOOR = np.array([226.0, 228.0, 230.0])
_LINE = np.array([168.0, 174.0, 182.0])
_GRIDS = ((0.25, 0.006, 0.35), (1.0, 0.014, 0.9))
"""Spacing and width of the grid's lines, m, and their darkness."""
_HAZE_M = 9.0  # Distance over which the floor fades into the sky, m
_SHADOW = 0.30
_STEEPEST_SKY = 0.35  # Slope of the ray at which the sky has its darkest blue


class Backdrop:
    """The scene without drones in the view of a lens, which is drawn once and copied."""

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        rays = lens.rays()
        slope = rays[..., 2]
        below = slope < -1e-6
        reach = np.where(below, lens.eye[2] / np.where(below, -slope, 1.0), np.inf)
        reach[reach <= 0.0] = np.inf
        seen = np.isfinite(reach)
        self._floor = np.full((*slope.shape, 2), np.inf)
        """Point (x, y) of the floor behind each pixel, m; infinite for the sky."""
        self._floor[seen] = lens.eye[:2] + rays[seen][:, :2] * reach[seen][:, None]
        height = np.clip(slope / _STEEPEST_SKY, 0.0, 1.0)[..., None]
        picture = _HORIZON + height * (_ZENITH - _HORIZON)
        picture[seen] = _floor(self._floor[seen], _footprint(lens, rays, reach)[seen], reach[seen])
        self._picture = np.rint(picture).astype(np.uint8)

    def draw(self, position: FloatArray, radius: FloatArray) -> npt.NDArray[np.uint8]:
        """Return a picture (height, width, 3) with shadows of drones at (N, 3), radii (N,), m."""
        picture = self._picture.copy()
        for p, r in zip(position, radius, strict=True):
            self._cast(picture, p, 1.3 * float(r) + 0.03 * float(p[2]))
        return picture

    def _cast(self, picture: npt.NDArray[np.uint8], position: FloatArray, radius: float) -> None:
        angle = np.linspace(0.0, 2 * math.pi, 16, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(16)], axis=1) * 1.05 * radius
        foot = np.array([position[0], position[1], 0.0])
        if (self.lens.depth(foot + rim) <= 0.1).any():
            return
        corners = self.lens.project(foot + rim)
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0) + 1
        rows = slice(max(int(top), 0), max(int(bottom), 0))
        columns = slice(max(int(left), 0), max(int(right), 0))
        patch = picture[rows, columns]
        if patch.size:
            away = np.hypot(*np.moveaxis(self._floor[rows, columns] - foot[:2], -1, 0)) / radius
            shade = _SHADOW * np.square(np.maximum(1.0 - np.square(away), 0.0))
            patch[:] = patch * (1.0 - shade[..., None])


def _footprint(lens: Lens, rays: FloatArray, reach: FloatArray) -> FloatArray:
    """Return the extent of each pixel on the floor, m: (height, width, 2) along x and y."""
    pixel = 2.0 * lens.tangent / lens.height
    slope = np.where(np.isfinite(reach), rays[..., 2], -1.0)
    far = np.where(np.isfinite(reach), reach, 0.0)
    lean = rays[..., :2] / slope[..., None]
    along = np.abs(lens.right[:2] - lean * lens.right[2])
    down = np.abs(lens.up[:2] - lean * lens.up[2])
    return np.asarray(far[..., None] * pixel * np.maximum(along, down))


def _floor(points: FloatArray, footprint: FloatArray, distance: FloatArray) -> FloatArray:
    dark = np.zeros(len(points))
    for spacing, width, strength in _GRIDS:
        away = np.abs(points - spacing * np.rint(points / spacing))
        blur = np.maximum(footprint, 1e-9)
        # The fraction of the pixel that the line covers, by the overlap of two intervals.
        overlap = np.minimum(away + blur / 2, width / 2) - np.maximum(away - blur / 2, -width / 2)
        cover = np.clip(overlap / blur, 0.0, 1.0) * np.clip(spacing / (4 * blur), 0.0, 1.0)
        dark = np.maximum(dark, strength * cover.max(axis=1))
    color = _FLOOR + dark[:, None] * (_LINE - _FLOOR)
    clear = np.exp(-np.square(distance / _HAZE_M))[:, None]
    return _HORIZON + clear * (color - _HORIZON)
