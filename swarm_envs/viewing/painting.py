"""Painter of obstacles, goals, trails, forces and drones, the farthest first.

As PIL does not anti-alias, a canvas is `ZOOM` times as large as the picture, and then averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Team
from swarm_envs.viewing.airframe import Airframes
from swarm_envs.viewing.lens import NEAREST, Lens
from swarm_envs.viewing.record import Solid
from swarm_envs.viewing.solids import SeenSolids
from swarm_envs.viewing.style import drone_colors

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

__all__ = ["NOTHING", "ZOOM", "Overlay", "Painter", "arena_edges", "draw_arrow"]

ZOOM = 2
"""Pixels of a canvas per pixel of the picture, along each side."""

Color = tuple[int, int, int, int]  # Red, green, blue, opacity, from 0 to 255

_EDGE: Color = (160, 167, 176, 255)
_SOLID_FACE: Color = (110, 120, 132, 130)
_SOLID_EDGE: Color = (80, 88, 98, 220)
_FORCE: Color = (176, 20, 155, 255)
_PIECE = 8  # Points of a trail that are in front of or behind an obstacle together
_TRAIL, _MARK, _DRONE = range(3)  # Layers: drones are above marks, and marks above trails


class Overlay(NamedTuple):
    """The marks of N drones in a picture; world frame, m."""

    goals: FloatArray | None = None  # (N, 3), drawn as diamonds
    references: FloatArray | None = None  # (N, 3), drawn as circles
    trails: FloatArray | None = None  # (K, N, 3) past positions, oldest first
    arrows: FloatArray | None = None  # (M, 2, 3) start and tip of forces


NOTHING = Overlay()
"""No marks."""


class _Stroke(NamedTuple):
    """An object to draw, and its position."""

    place: FloatArray  # (3,) m
    radius: float  # Radius of its bounding sphere, m
    layer: int
    draw: Callable[[], None]


class Painter:
    """Painter of the objects in front of a lens, in order of occlusion.

    Args:
        lens: the lens of the canvas.
        team: the N vehicles.
        solids: the obstacles, drawn translucent.
        arena: (2, 3) corners, m; its edges are drawn behind everything.
    """

    def __init__(
        self, lens: Lens, team: Team, solids: Sequence[Solid] = (), arena: FloatArray | None = None
    ) -> None:
        self._lens, self._arena = lens, arena
        self._frames = Airframes(team)
        self._radii = [vehicle.radius for vehicle in team]
        self._solids = SeenSolids(lens, solids)
        self._inks = [_ink(color) for color in drone_colors(team)]

    def paint(
        self, canvas: Image, position: FloatArray, quaternion: FloatArray, overlay: Overlay
    ) -> None:
        """Draw drones at (N, 3), m, with attitudes (N, 4), obstacles and marks on a backdrop."""
        from PIL.ImageDraw import Draw

        pen = _Pen(Draw(canvas, "RGBA"), self._lens)
        if self._arena is not None:
            for edge in arena_edges(self._arena):
                pen.line(edge, _EDGE, 1)
        strokes = [*self._marks(pen, overlay), *self._drones(Draw(canvas), position, quaternion)]
        places = np.array([stroke.place for stroke in strokes])
        layers = np.array([stroke.layer for stroke in strokes])
        radii = np.array([stroke.radius for stroke in strokes])
        before = self._solids.first_over(places, radii)
        away = np.linalg.norm(places - self._lens.eye, axis=1)
        drawn = 0
        for i in np.lexsort((-away, layers, before)):
            for part in self._solids.parts[drawn : before[i]]:
                pen.solid(part.solid, part.outline)
            drawn = before[i]
            strokes[i].draw()
        for part in self._solids.parts[drawn:]:
            pen.solid(part.solid, part.outline)

    def _marks(self, pen: _Pen, overlay: Overlay) -> Iterator[_Stroke]:
        if overlay.trails is not None:
            for path, ink in zip(np.swapaxes(overlay.trails, 0, 1), self._inks, strict=True):
                for piece in self._pieces(path):
                    middle, reach = (piece[0] + piece[-1]) / 2, piece[-1] - piece[0]
                    draw = partial(pen.line, piece, _pale(ink), 2)
                    yield _Stroke(middle, float(np.linalg.norm(reach)) / 2, _TRAIL, draw)
        for points, mark in ((overlay.goals, pen.diamond), (overlay.references, pen.circle)):
            if points is not None:
                for point, ink in zip(points, self._inks, strict=True):
                    yield _Stroke(point, 0.0, _MARK, partial(mark, point, ink))
        if overlay.arrows is not None:
            for foot, tip in overlay.arrows:
                yield _Stroke(foot, 0.0, _MARK, partial(pen.arrow, foot, tip))

    def _pieces(self, path: FloatArray) -> list[FloatArray]:
        step = _PIECE if self._solids.parts else len(path)
        return [path[k : k + step + 1] for k in range(0, max(len(path) - 1, 1), step)]

    def _drones(
        self, pen: ImageDraw, position: FloatArray, quaternion: FloatArray
    ) -> Iterator[_Stroke]:
        faces = self._frames.faces(self._lens, position, quaternion, self._inks)
        for place, radius, own in zip(position, self._radii, faces, strict=True):
            yield _Stroke(place, radius, _DRONE, partial(_fill, pen, own))


def _fill(pen: ImageDraw, faces: Sequence[tuple[list[float], tuple[int, int, int]]]) -> None:
    for corners, color in faces:
        pen.polygon(corners, fill=color, outline=color)


def draw_arrow(
    canvas: ImageDraw, foot: FloatArray, tip: FloatArray, ink: str | Color, width: int, head: float
) -> None:
    """Draw an arrow between two pixels (2,), unless it is shorter than its head."""
    length = float(np.linalg.norm(tip - foot))
    if length < head:
        return
    ahead = (tip - foot) / length
    across, neck = np.array([-ahead[1], ahead[0]]), tip - head * ahead
    canvas.line([tuple(foot), tuple(neck)], fill=ink, width=width)
    corners = (tip, neck + 0.5 * head * across, neck - 0.5 * head * across)
    canvas.polygon([(float(x), float(y)) for x, y in corners], fill=ink)


class _Pen:
    """Pen that draws shapes in world coordinates on a canvas."""

    def __init__(self, canvas: ImageDraw, lens: Lens) -> None:
        self._canvas, self._lens = canvas, lens

    def line(self, path: FloatArray, ink: Color, width: int) -> None:
        if self._lens.depth(path).min() > NEAREST:
            pieces = [path]
        else:
            pieces = list(visible_parts(self._lens, path))
        for piece in pieces:
            if len(piece) > 1:
                self._canvas.line(self._pixels(piece), fill=ink, width=ZOOM * width)

    def solid(self, solid: Solid, outline: list[tuple[float, float]]) -> None:
        """Draw a translucent solid; `outline` is its outline on the canvas, or empty."""
        if outline:
            self._canvas.polygon(outline, fill=_SOLID_FACE)
        bottom, top = solid.rings()
        uprights = [] if solid.round else list(np.stack([bottom, top], axis=1))
        for line in (*(np.vstack([ring, ring[:1]]) for ring in (bottom, top)), *uprights):
            self.line(line, _SOLID_EDGE, 1)

    def diamond(self, point: FloatArray, ink: Color) -> None:
        r = 11.0
        for x, y in self._pixels(point[None]):
            corners = [(x - r, y), (x, y - r), (x + r, y), (x, y + r), (x - r, y)]
            self._canvas.line(corners, fill=ink, width=4, joint="curve")

    def circle(self, point: FloatArray, ink: Color) -> None:
        r = 9.0
        for x, y in self._pixels(point[None]):
            self._canvas.ellipse((x - r, y - r, x + r, y + r), outline=ink, width=3)

    def arrow(self, foot: FloatArray, tip: FloatArray) -> None:
        ends = self._pixels(np.stack([foot, tip]))
        if len(ends) == 2:
            start, end = np.array(ends)
            draw_arrow(self._canvas, start, end, _FORCE, width=4, head=14.0)

    def _pixels(self, points: FloatArray) -> list[tuple[float, float]]:
        """Return the pixels of the points that are in front of the camera."""
        before = points[self._lens.depth(points) > 0.5 * NEAREST]
        return [(x, y) for x, y in self._lens.project(before).tolist()]


def arena_edges(arena: npt.ArrayLike) -> FloatArray:
    """Return the edges (12, 2, 3) of a box with corners (2, 3)."""
    given = np.asarray(arena, dtype=np.float64)
    corners = np.array(
        [[given[i, 0], given[j, 1], given[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    ends = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    return np.asarray(corners[np.array(ends)])


def visible_parts(lens: Lens, path: FloatArray) -> Iterator[FloatArray]:
    """Yield the segments (2, 3) of a path (K, 3) in front of the camera, clipped at its plane."""
    depth = lens.depth(path) - NEAREST
    for (a, da), (b, db) in pairwise(zip(path, depth, strict=True)):
        if da <= 0.0 and db <= 0.0:
            continue
        cut = a + (b - a) * (da / (da - db)) if da * db < 0.0 else a
        yield np.array([cut if da <= 0.0 else a, cut if db <= 0.0 else b])


def _ink(color: str) -> Color:
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue, 255


def _pale(ink: Color) -> Color:
    red, green, blue = (round(0.65 * part + 0.35 * 255) for part in ink[:3])
    return red, green, blue, 255
