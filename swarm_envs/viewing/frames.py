"""Pictures of a running environment: what `render()` gives with `render_mode="rgb_array"`."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.viewing.camera import Camera
from swarm_envs.viewing.overlay import Overlay
from swarm_envs.viewing.record import solids
from swarm_envs.viewing.style import drone_colors

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.envs.view import View

__all__ = ["Screen"]

WIDTH, HEIGHT = 640, 480
"""Size of a picture, pixels."""
_TRAIL_S = 2.0
_PATH_POINTS = 24
"""Of each drone's reference, for the camera's aim."""


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
        self._camera = Camera(task.team, WIDTH, HEIGHT)
        self._arena = task.arena
        self._solids = solids(getattr(task, "obstacles", ()), float(task.arena[1, 2]))
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
            self._camera = Camera(view.team, WIDTH, HEIGHT)
        times = np.linspace(0.0, view.horizon_s, _PATH_POINTS)
        paths = [view.reference(float(t)).position for t in times]
        self._camera.aim(np.concatenate([view.state.position, view.goals, *paths]))
