"""A camera that draws a swarm with Bullet's renderer on the CPU: it needs no display.

`Lens` is the geometry of its pinhole. Behind the drones are a floor with a grid, a pale sky, and
soft shadows. `Screen` is what `render()` gives with `render_mode="rgb_array"`.
"""

from __future__ import annotations

import importlib
import math
import weakref
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import check_integer, check_number
from swarm_envs.physics.bullet import build_body
from swarm_envs.state import BoolArray, FloatArray, SwarmState
from swarm_envs.vehicles import Vehicle, parse_team
from swarm_envs.viewing.overlay import Overlay, draw_behind
from swarm_envs.viewing.record import solids
from swarm_envs.viewing.style import drone_colors

__all__ = ["Screen"]

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.envs.view import View

_NEAREST = 0.5  # No point is nearer to the eye than this, m


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

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (..., 2), as (column, row), of points (..., 3) before the camera."""
        ray = np.asarray(points, dtype=np.float64) - self.eye
        scale = self.height / (2.0 * self.tangent) / (ray @ self.forward)
        column = self.width / 2 + scale * (ray @ self.right)
        row = self.height / 2 - scale * (ray @ self.up)
        return np.stack([column, row], axis=-1)

    def sees(self, points: npt.ArrayLike) -> BoolArray:
        """Whether each of the points (..., 3) lies in the picture."""
        p = np.asarray(points, dtype=np.float64)
        before = (p - self.eye) @ self.forward > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = np.moveaxis(self.project(p), -1, 0)
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        return np.asarray(before & inside)

    def rays(self) -> FloatArray:
        """Direction (height, width, 3) of the ray through the centre of each pixel."""
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
    distance = float((np.maximum(np.maximum(beside, above), _NEAREST) + offset @ back).max())
    return Lens(width, height, tangent, target + distance * back, right, up, -back)


_ZENITH = np.array([206.0, 220.0, 235.0])
_HORIZON = np.array([246.0, 248.0, 250.0])
_FLOOR = np.array([226.0, 228.0, 230.0])
_LINE = np.array([168.0, 174.0, 182.0])
_GRIDS = ((0.25, 0.006, 0.35), (1.0, 0.014, 0.9))
"""Spacing and width of the grid's lines, m, and how dark they are."""
_HAZE_M = 9.0  # Distance over which the floor fades into the sky, m
_SHADOW = 0.30
_STEEPEST_SKY = 0.35  # Slope of the ray at which the sky has its darkest blue


class _Backdrop:
    """The scene without drones, as one camera sees it: drawn once, then copied."""

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        rays = lens.rays()
        slope = rays[..., 2]
        below = slope < -1e-6
        reach = np.where(below, lens.eye[2] / np.where(below, -slope, 1.0), np.inf)
        reach[reach <= 0.0] = np.inf
        seen = np.isfinite(reach)
        self._floor = np.full((*slope.shape, 2), np.inf)
        """Point (x, y) of the floor behind each pixel, m; infinite where there is sky."""
        self._floor[seen] = lens.eye[:2] + rays[seen][:, :2] * reach[seen][:, None]
        height = np.clip(slope / _STEEPEST_SKY, 0.0, 1.0)[..., None]
        picture = _HORIZON + height * (_ZENITH - _HORIZON)
        picture[seen] = _floor(self._floor[seen], _footprint(lens, rays, reach)[seen], reach[seen])
        self._picture = np.rint(picture).astype(np.uint8)

    def draw(self, position: FloatArray, radius: FloatArray) -> npt.NDArray[np.uint8]:
        """A new picture (height, width, 3) with shadows of drones at (N, 3), of radii (N,), m."""
        picture = self._picture.copy()
        for p, r in zip(position, radius, strict=True):
            self._cast(picture, p, 1.3 * float(r) + 0.03 * float(p[2]))
        return picture

    def _cast(self, picture: npt.NDArray[np.uint8], position: FloatArray, radius: float) -> None:
        angle = np.linspace(0.0, 2 * math.pi, 16, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(16)], axis=1) * 1.05 * radius
        foot = np.array([position[0], position[1], 0.0])
        if ((foot + rim - self.lens.eye) @ self.lens.forward <= 0.1).any():
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
    """Extent of each pixel on the floor, m: (height, width, 2) along x and y."""
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
        # The part of the pixel that the line covers, by the overlap of two intervals.
        overlap = np.minimum(away + blur / 2, width / 2) - np.maximum(away - blur / 2, -width / 2)
        cover = np.clip(overlap / blur, 0.0, 1.0) * np.clip(spacing / (4 * blur), 0.0, 1.0)
        dark = np.maximum(dark, strength * cover.max(axis=1))
    color = _FLOOR + dark[:, None] * (_LINE - _FLOOR)
    clear = np.exp(-np.square(distance / _HAZE_M))[:, None]
    return _HORIZON + clear * (color - _HORIZON)


_BACKGROUND = -1  # What Bullet's segmentation says where it drew nothing
_PIXELS = {"at_least": 16, "at_most": 4096}  # of a picture, along each side


class Camera:
    """Draws pictures of a team from states of any engine, in a Bullet client of its own.

    It stands still: it aims at the drones of the first picture, or at what `aim` was given, and
    aims again only when a drone leaves the picture. Call `close()` when done.

    Args:
        team: the vehicles, N of them.
        width: of the picture, pixels.
        height: of the picture, pixels.
        azimuth_deg: where the camera stands seen from the swarm, counter-clockwise from x.
        elevation_deg: how far above the swarm's horizon it stands, 0 to 89.
        field_of_view_deg: vertical, 5 to 120.

    Raises:
        ImportError: pybullet is not installed.
        ValueError: the picture would be empty, or an angle is impossible.
    """

    def __init__(
        self,
        team: str | Sequence[Vehicle],
        width: int = 640,
        height: int = 400,
        *,
        azimuth_deg: float = -60.0,
        elevation_deg: float = 16.0,
        field_of_view_deg: float = 35.0,
    ) -> None:
        check_integer("width", width, **_PIXELS)
        check_integer("height", height, **_PIXELS)
        check_number("azimuth_deg", azimuth_deg, at_least=-360.0, at_most=360.0)
        check_number("elevation_deg", elevation_deg, at_least=0.0, at_most=89.0)
        check_number("field_of_view_deg", field_of_view_deg, at_least=5.0, at_most=120.0)
        self.team = parse_team(team)
        self.width, self.height = width, height
        self._angles = azimuth_deg, elevation_deg, field_of_view_deg
        self._radius = np.array([vehicle.radius for vehicle in self.team])
        self._backdrop: _Backdrop | None = None
        self._matrices: tuple[Any, Any] = ((), ())
        self._bullet = _import_renderer()
        self._client = int(self._bullet.connect(self._bullet.DIRECT))
        if self._client < 0:
            raise RuntimeError("Bullet gave no client: too many are open; close() what is done")
        self._finalizer = weakref.finalize(self, self._bullet.disconnect, self._client)
        self._bodies = [
            build_body(self._bullet, self._client, vehicle, vehicle.mass, list(vehicle.inertia))
            for vehicle in self.team
        ]

    @property
    def lens(self) -> Lens:
        """Where the camera stands and what it sees.

        Raises:
            RuntimeError: it has not aimed yet.
        """
        if self._backdrop is None:
            raise RuntimeError("the camera has not aimed yet; call aim() or picture() first")
        return self._backdrop.lens

    def aim(self, points: npt.ArrayLike) -> None:
        """Stand so that points (..., 3), m, are in the picture, with room around them."""
        margin = 2.0 * float(self._radius.max()) + 0.05
        lens = aim(points, self.width, self.height, *self._angles, margin)
        self._backdrop = _Backdrop(lens)
        view = self._bullet.computeViewMatrix(
            lens.eye.tolist(), (lens.eye + lens.forward).tolist(), [0.0, 0.0, 1.0]
        )
        opening = math.degrees(2.0 * math.atan(lens.tangent))
        projection = self._bullet.computeProjectionMatrixFOV(
            opening, self.width / self.height, 0.05, 100.0
        )
        self._matrices = view, projection

    def picture(self, state: SwarmState, overlay: Overlay | None = None) -> npt.NDArray[np.uint8]:
        """Draw a state.

        Args:
            state: its arrays lead with N alone, as those of `env.view.state`.
            overlay: what to draw behind the drones.

        Returns:
            (height, width, 3) RGB, a new array.

        Raises:
            ValueError: the state is not one of this team.
            RuntimeError: the camera is closed.
        """
        position = self._place(state)
        if self._backdrop is None or not self.lens.sees(position).all():
            self.aim(position)
        assert self._backdrop is not None
        picture = self._backdrop.draw(position, self._radius)
        if overlay is not None:
            picture = draw_behind(picture, self.lens, overlay)
        drones, drawn = self._draw_drones()
        picture[drawn] = drones[drawn]
        return picture

    def close(self) -> None:
        """Free Bullet's client. May be called more than once."""
        self._finalizer()

    def _place(self, state: SwarmState) -> FloatArray:
        if not self._finalizer.alive:
            raise RuntimeError("this camera is closed; make a new one")
        position, quaternion = np.asarray(state.position), np.asarray(state.quaternion)
        n = len(self.team)
        if position.shape != (n, 3) or quaternion.shape != (n, 4):
            raise ValueError(
                f"the state has positions of shape {position.shape}, but this camera's team needs "
                f"({n}, 3): give the state of one environment, without the leading axis"
            )
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            raise ValueError("the state holds NaN or infinity; it cannot be drawn")
        for body, p, q in zip(self._bodies, position.tolist(), quaternion.tolist(), strict=True):
            self._bullet.resetBasePositionAndOrientation(body, p, q, physicsClientId=self._client)
        return position

    def _draw_drones(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
        """Picture of the drones alone, and where they are in it.

        The floor is not Bullet's: its renderer takes five times as long with one.
        """
        shape = (self.height, self.width)
        _, _, colors, _, labels = self._bullet.getCameraImage(
            self.width,
            self.height,
            *self._matrices,
            lightDirection=(self.lens.right * 0.4 - self.lens.forward + self.lens.up * 2).tolist(),
            lightAmbientCoeff=0.75,
            lightDiffuseCoeff=0.55,
            lightSpecularCoeff=0.1,
            shadow=0,
            renderer=self._bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        rgba = np.asarray(colors, dtype=np.uint8).reshape(*shape, 4)
        return rgba[..., :3], np.asarray(labels).reshape(shape) != _BACKGROUND


def _import_renderer() -> Any:
    try:
        return importlib.import_module("pybullet")
    except ImportError as error:
        raise ImportError(
            f"drawing needs pybullet, which cannot be imported here ({error}). It has wheels for "
            "Linux x86-64 and CPython up to 3.11: `pip install pybullet`. Without it fly with "
            "render_mode=None and look at the replay page, which needs none: `swarm-envs fly "
            "--replay out.html`, or swarm_envs.viewing.replay.write_replay(path, recording)."
        ) from error


_SCREEN = 640, 480  # Size of a picture, pixels
_TRAIL_S = 2.0
_PATH_POINTS = 24  # Of each drone's reference, for the camera's aim


class Screen:
    """Draws an environment as it is now: drones, arena, obstacles, goals, references, trails.

    The camera aims once an episode, at what the drones are going to pass. Trails join what was
    drawn, so they are as fine as `render()` is called often.

    Args:
        core: the environment.

    Raises:
        ImportError: pybullet is not installed.
    """

    def __init__(self, core: SwarmCore) -> None:
        task = core.task
        self._camera = Camera(task.team, *_SCREEN)
        self._arena = task.arena
        self._solids = solids(task.obstacles, float(task.arena[1, 2]))
        self._past: deque[tuple[float, FloatArray]] = deque()

    def render(self, view: View) -> npt.NDArray[np.uint8]:
        """A new RGB picture (480, 640, 3)."""
        time, position = view.time, np.array(view.state.position)
        if not self._past or time < self._past[-1][0] or self._is_new(view):
            self._begin(view)
        if not self._past or time > self._past[-1][0]:
            self._past.append((time, position))
        while self._past[0][0] < time - _TRAIL_S:
            self._past.popleft()
        reference = view.reference(time).position
        moving = not np.array_equal(reference, view.goals)
        overlay = Overlay(
            colors=drone_colors(view.team),
            arena=self._arena,
            solids=self._solids,
            goals=np.array(view.goals),
            references=np.array(reference) if moving else None,
            trails=np.array([p for _, p in self._past]),
        )
        return self._camera.picture(view.state, overlay)

    def close(self) -> None:
        """Free the camera. May be called more than once."""
        self._camera.close()

    def _is_new(self, view: View) -> bool:
        """Whether another episode has begun although time did not go back."""
        begun = view.time == 0.0 and not np.array_equal(self._past[-1][1], view.state.position)
        return bool(begun) or view.team != self._camera.team

    def _begin(self, view: View) -> None:
        self._past.clear()
        if view.team != self._camera.team:  # a reset may name another
            self._camera.close()
            self._camera = Camera(view.team, *_SCREEN)
        times = np.linspace(0.0, view.horizon_s, _PATH_POINTS)
        paths = [view.reference(float(t)).position for t in times]
        self._camera.aim(np.concatenate([view.state.position, view.goals, *paths]))
