"""A camera that draws a swarm on the CPU, without a display.

`Screen` draws the pictures of `render()` with `render_mode="rgb_array"`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import check_integer, check_number
from swarm_envs.state import FloatArray, SwarmState
from swarm_envs.vehicles import Team, Vehicle, parse_team
from swarm_envs.viewing.floor import Backdrop
from swarm_envs.viewing.lens import Lens, aim
from swarm_envs.viewing.painting import NOTHING, ZOOM, Overlay, Painter
from swarm_envs.viewing.record import Solid, solids

if TYPE_CHECKING:
    from PIL.Image import Image

    from swarm_envs.envs.view import View
    from swarm_envs.tasks.base import Task

__all__ = ["Camera", "Screen"]

Picture = npt.NDArray[np.uint8]  # (height, width, 3) red, green, blue

_PIXELS = {"at_least": 16, "at_most": 4096}  # Allowed sizes of a picture


class Camera:
    """A camera that draws a team from states of any physics engine.

    It does not move: it aims at the drones of the first picture, or at the points of `aim`, and
    aims again only when a drone leaves the picture.

    Args:
        team: the N vehicles.
        width: width of the picture, pixels.
        height: height of the picture, pixels.
        azimuth_deg: direction from the swarm to the camera, counter-clockwise from x.
        elevation_deg: angle of the camera above the horizon, 0 to 89.
        field_of_view_deg: vertical field of view, 5 to 120.
        solids: the obstacles.
        arena: (2, 3) corners of the arena, m, whose edges are drawn.

    Raises:
        ValueError: a size or an angle is out of range.
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
        solids: Sequence[Solid] = (),
        arena: FloatArray | None = None,
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
        self._solids, self._arena = solids, arena
        self._scene: tuple[Backdrop, Painter] | None = None

    @property
    def lens(self) -> Lens:
        """The lens: position, direction and field of view.

        Raises:
            RuntimeError: the camera has not aimed yet.
        """
        if self._scene is None:
            raise RuntimeError("the camera has not aimed yet; call aim() or picture() first")
        return self._scene[0].lens

    def aim(self, points: npt.ArrayLike) -> None:
        """Place the camera so that points (..., 3), m, are in the picture, with a margin."""
        margin = 2.0 * float(self._radius.max()) + 0.05
        lens = aim(points, self.width, self.height, *self._angles, margin)
        large = replace(lens, width=ZOOM * self.width, height=ZOOM * self.height)
        painter = Painter(large, self.team, self._solids, self._arena)
        self._scene = Backdrop(lens), painter

    def picture(self, state: SwarmState, overlay: Overlay = NOTHING) -> Picture:
        """Draw a state.

        Args:
            state: the state of one environment, with arrays (N, ...), as `env.view.state`.
            overlay: the marks to draw besides the drones.

        Returns:
            (height, width, 3) RGB, a new array.

        Raises:
            ValueError: the state has another shape, or is not finite.
        """
        return np.array(self.canvas(state, overlay).reduce(ZOOM))

    def canvas(self, state: SwarmState, overlay: Overlay = NOTHING) -> Image:
        """Return the picture before it is averaged: an image of twice the width and height."""
        from PIL import Image

        position, quaternion = self._poses(state)
        if self._scene is None or not self.lens.sees(position).all():
            self.aim(position)
        assert self._scene is not None
        backdrop, painter = self._scene
        image = Image.fromarray(backdrop.draw(position, self._radius))
        image = image.resize((ZOOM * self.width, ZOOM * self.height), Image.Resampling.NEAREST)
        painter.paint(image, position, quaternion, overlay)
        return image

    def _poses(self, state: SwarmState) -> tuple[FloatArray, FloatArray]:
        """Return positions and quaternions; raise ValueError as `picture`."""
        position, quaternion = np.asarray(state.position), np.asarray(state.quaternion)
        n = len(self.team)
        if position.shape != (n, 3) or quaternion.shape != (n, 4):
            raise ValueError(
                f"the state has positions of shape {position.shape}, but this camera's team needs "
                f"({n}, 3): give the state of one environment, without the leading axis"
            )
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            raise ValueError("the state has NaN or infinity; give a finite state")
        return position, quaternion


_SCREEN = 640, 480  # Size of a picture, pixels
_TRAIL_S = 2.0
_PATH_POINTS = 24  # Points of each drone's reference at which the camera aims


class Screen:
    """Renderer of an environment: drones, arena, obstacles, goals, references and trails.

    The camera aims once per episode, at starts, goals and references. Trails connect the positions
    of previous calls of `render`.

    Args:
        task: the task of the environment.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._past: deque[tuple[float, FloatArray]] = deque()
        self._camera = self._make_camera(task.team)

    def render(self, view: View) -> Picture:
        """Return a new RGB picture (480, 640, 3)."""
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
            goals=view.goals,
            references=reference if moving else None,
            trails=np.array([p for _, p in self._past]),
        )
        return self._camera.picture(view.state, overlay)

    def _make_camera(self, team: Team) -> Camera:
        arena = self._task.arena
        parts = solids(self._task.obstacles, float(arena[1, 2]))
        return Camera(team, *_SCREEN, solids=parts, arena=arena)

    def _is_new(self, view: View) -> bool:
        """Return True if another episode has begun although time did not decrease."""
        begun = view.time == 0.0 and not np.array_equal(self._past[-1][1], view.state.position)
        return bool(begun) or view.team != self._camera.team

    def _begin(self, view: View) -> None:
        self._past.clear()
        if view.team != self._camera.team:  # a reset may change the team
            self._camera = self._make_camera(view.team)
        times = np.linspace(0.0, view.horizon_s, _PATH_POINTS)
        paths = [view.reference(float(t)).position for t in times]
        self._camera.aim(np.concatenate([view.state.position, view.goals, *paths]))
