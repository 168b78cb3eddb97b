"""Obstacles in the view of a lens: outlines, drawing order and occlusion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.viewing.lens import NEAREST, Lens
from swarm_envs.viewing.record import Solid

__all__ = ["SeenSolids"]


class SeenPart(NamedTuple):
    """A solid and its outline on the canvas, empty if it extends behind the camera."""

    solid: Solid
    outline: list[tuple[float, float]]


class SeenSolids:
    """The obstacles of a scene in the view of a lens.

    A solid cannot hide objects that are entirely in front of the plane of one of its visible faces.
    Other objects that overlap it on the canvas are drawn before it.

    Args:
        lens: the lens of the canvas.
        solids: the S obstacles.
    """

    parts: list[SeenPart]
    """The solids in the order in which they are drawn."""

    def __init__(self, lens: Lens, solids: Sequence[Solid]) -> None:
        self._lens = lens
        corners = [solid.rings().reshape(-1, 3) for solid in solids]
        faces = [_visible_faces(solid, lens.eye) for solid in solids]
        boxes = [_box_of(lens, points) for points in corners]
        order = self._order(corners, faces, boxes)
        self._faces, self._boxes = [faces[s] for s in order], [boxes[s] for s in order]
        self.parts = [SeenPart(solids[s], _outline(lens, corners[s])) for s in order]

    def first_over(self, points: FloatArray, radii: FloatArray) -> IntArray:
        """Return the index (T,) of the first of `parts` that hides each point (T, 3), or S.

        A point has a bounding sphere of radius (T,), m, for the overlap on the canvas.
        """
        first = np.full(len(points), len(self.parts), dtype=np.int64)
        depth = np.maximum(self._lens.depth(points), NEAREST)
        size = (self._lens.focal * radii / depth)[:, None]
        pixels = self._lens.project(points)
        for s in reversed(range(len(self.parts))):
            low, high = self._boxes[s]
            overlaps = ((pixels + size >= low) & (pixels - size <= high)).all(axis=1)
            first[overlaps & ~_beyond(self._faces[s], points[:, None])] = s
        return first

    def _order(
        self,
        corners: Sequence[FloatArray],
        faces: Sequence[FloatArray],
        boxes: Sequence[FloatArray],
    ) -> list[int]:
        """Return the order of the solids from back to front by occlusion, else by distance."""
        away = [float(np.linalg.norm(points.mean(axis=0) - self._lens.eye)) for points in corners]
        left = sorted(range(len(corners)), key=lambda s: -away[s])

        def hides(s: int, t: int) -> bool:
            overlap = (boxes[s][0] <= boxes[t][1]) & (boxes[t][0] <= boxes[s][1])
            return bool(s != t and overlap.all() and not _beyond(faces[s], corners[t][None])[0])

        order = []
        while left:
            free = (s for s in left if not any(hides(s, t) for t in left))
            order.append(next(free, left[0]))
            left.remove(order[-1])
        return order


def _visible_faces(solid: Solid, eye: FloatArray) -> FloatArray:
    """Return the planes (F, 4), outward normal and offset, of the faces visible to the eye."""
    bottom, top = solid.rings()
    along = np.roll(bottom, -1, axis=0) - bottom
    sides = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(bottom))])
    normals = np.vstack([sides, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    points = np.vstack([bottom, top[:1], bottom[:1]])
    offset = (normals * points).sum(axis=1)
    return np.asarray(np.column_stack([normals, offset])[normals @ eye > offset])


def _beyond(faces: FloatArray, points: FloatArray) -> BoolArray:
    """Return True (T,) for objects (T, K, 3) with all points in front of one of planes (F, 4)."""
    beyond: BoolArray = points @ faces[:, :3].T >= faces[:, 3] - 1e-9
    return np.asarray(np.any(np.all(beyond, axis=1), axis=1))


def _box_of(lens: Lens, points: FloatArray) -> FloatArray:
    """Return the bounding box (2, 2) of a solid, pixels; infinite if it is behind the camera."""
    if lens.depth(points).min() <= NEAREST:
        return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    pixels = lens.project(points)
    return np.stack([pixels.min(axis=0), pixels.max(axis=0)])


def _outline(lens: Lens, points: FloatArray) -> list[tuple[float, float]]:
    from scipy.spatial import ConvexHull

    if lens.depth(points).min() <= NEAREST:
        return []
    pixels = lens.project(points)
    return [(x, y) for x, y in pixels[ConvexHull(pixels).vertices].tolist()]
