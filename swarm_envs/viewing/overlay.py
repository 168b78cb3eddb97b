"""What a picture shows besides the drones: arena, obstacles, goals, references, trails, forces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.viewing.record import Solid

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

    from swarm_envs.viewing.camera import Lens

Picture = npt.NDArray[np.uint8]  # (height, width, 3) red, green, blue
Color = tuple[int, int, int, int]  # Red, green, blue, opacity, from 0 to 255

_EDGE: Color = (160, 167, 176, 255)
_SOLID_FACE: Color = (110, 120, 132, 95)
_SOLID_EDGE: Color = (80, 88, 98, 220)
_FORCE: Color = (176, 20, 155, 255)
_NEAREST = 0.05  # Nothing nearer to the eye is drawn, m


class Overlay(NamedTuple):
    """What to draw, world frame, m. N drones."""

    colors: Sequence[str]  # N colours, `#rrggbb`, of goals, references and trails
    arena: FloatArray | None = None  # (2, 3) corners; its edges are drawn
    solids: Sequence[Solid] = ()  # Obstacles, seen through
    goals: FloatArray | None = None  # (N, 3), drawn as diamonds
    references: FloatArray | None = None  # (N, 3), drawn as circles
    trails: FloatArray | None = None  # (K, N, 3) positions so far, oldest first
    arrows: FloatArray | None = None  # (N, 2, 3) foot and tip of each drone's force
    enlarged: bool = False
    """Whether the picture will be averaged to half its size. If not, lines are smoothed here."""


def draw_behind(picture: Picture, lens: Lens, overlay: Overlay) -> Picture:
    """Draw everything on a picture (height, width, 3) in which the drones are still missing."""
    from PIL import Image, ImageDraw

    canvas = Image.fromarray(picture)
    if not overlay.enlarged:  # PIL does not smooth lines: draw at twice the size, then average
        canvas = canvas.resize((2 * lens.width, 2 * lens.height), Image.Resampling.NEAREST)
    pen = _Pen(ImageDraw.Draw(canvas, "RGBA"), lens, 1 if overlay.enlarged else 2)
    for part in overlay.solids:
        pen.solid(part)
    if overlay.arena is not None:
        for edge in arena_edges(overlay.arena):
            pen.line(edge, _EDGE, 1)
    inks = [_ink(color) for color in overlay.colors]
    if overlay.trails is not None:
        for path, ink in zip(np.swapaxes(overlay.trails, 0, 1), inks, strict=True):
            pen.line(path, _pale(ink), 2)
    for points, mark in ((overlay.goals, pen.diamond), (overlay.references, pen.circle)):
        if points is not None:
            for point, ink in zip(points, inks, strict=True):
                mark(point, ink)
    if overlay.arrows is not None:
        for foot, tip in overlay.arrows:
            pen.arrow(foot, tip)
    return np.array(canvas if overlay.enlarged else canvas.reduce(2))


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
    """Draws shapes of the world on a picture that is drawn at twice its final size.

    A pixel of the lens is `zoom` pixels of the canvas.
    """

    def __init__(self, canvas: ImageDraw, lens: Lens, zoom: int) -> None:
        self._canvas, self._lens, self._zoom = canvas, lens, zoom

    def line(self, path: FloatArray, ink: Color, width: int) -> None:
        points = np.asarray(path)
        if ((points - self._lens.eye) @ self._lens.forward > _NEAREST).all():
            pieces = [points]
        else:
            pieces = list(visible_parts(self._lens, points))
        for piece in pieces:
            if len(piece) > 1:
                self._canvas.line(self._pixels(piece), fill=ink, width=2 * width)

    def solid(self, solid: Solid) -> None:
        bottom, top = solid.rings()
        around = [
            np.array([a, b, d, c])
            for a, b, c, d in zip(
                bottom, np.roll(bottom, -1, 0), top, np.roll(top, -1, 0), strict=True
            )
        ]
        for face in (bottom, *around, top):
            if ((face - self._lens.eye) @ self._lens.forward > _NEAREST).all():
                self._canvas.polygon(self._pixels(face), fill=_SOLID_FACE)
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
        if len(ends) < 2:
            return
        start, end = np.array(ends)
        draw_arrow(self._canvas, start, end, _FORCE, width=4, head=14.0)

    def _pixels(self, points: FloatArray) -> list[tuple[float, float]]:
        """Places on the canvas of the points that lie before the camera."""
        before = points[(points - self._lens.eye) @ self._lens.forward > 0.5 * _NEAREST]
        zoom = self._zoom
        return [(zoom * float(x), zoom * float(y)) for x, y in self._lens.project(before)]


def arena_edges(arena: FloatArray) -> FloatArray:
    """The twelve edges (12, 2, 3) of a box with corners (2, 3)."""
    corners = np.array(
        [[arena[i, 0], arena[j, 1], arena[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    ends = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    return np.asarray(corners[np.array(ends)])


def visible_parts(lens: Lens, path: FloatArray) -> Iterator[FloatArray]:
    """Pieces (2, 3) of a path (K, 3) that lie before the camera, cut where it passes the eye."""
    depth = (path - lens.eye) @ lens.forward - _NEAREST
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
