"""Pictures of a running environment: what `render()` gives, and the window that shows it."""

from __future__ import annotations

from collections import deque
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

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
_FILES_ONLY = {"agg", "cairo", "pdf", "pgf", "ps", "svg", "template"}
"""matplotlib's backends that open no window."""
_PATH_POINTS = 24
"""Of each drone's reference, for the camera's aim."""


class Screen:
    """Draws an environment as it is now: drones, arena, obstacles, goals, references, trails.

    The camera aims once an episode, at what the drones are going to pass. Trails join what was
    drawn, so they are as fine as `render()` is called often.

    Args:
        core: the environment.
        mode: `rgb_array`, or `human` for a window.

    Raises:
        ImportError: pybullet is not installed.
        RuntimeError: `human` without a display.
    """

    def __init__(self, core: SwarmCore, mode: str) -> None:
        task = core.task
        self._camera = Camera(task.team, WIDTH, HEIGHT)
        self._arena = task.arena
        self._solids = solids(getattr(task, "obstacles", ()), float(task.arena[1, 2]))
        self._past: deque[tuple[float, FloatArray]] = deque()
        self._window = Window(task.name, core.config.decision_rate) if mode == "human" else None

    def render(self, view: View) -> npt.NDArray[np.uint8] | None:
        """A new RGB picture (480, 640, 3), or None after it was shown in the window."""
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
        picture = self._camera.picture(view.state, overlay)
        if self._window is None:
            return picture
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Free camera and window. May be called more than once."""
        self._camera.close()
        if self._window is not None:
            self._window.close()

    def _is_new(self, view: View) -> bool:
        """Whether another episode is on although the clock did not go back."""
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


class Window:
    """A window that shows pictures, for `render_mode="human"`. matplotlib draws it.

    Args:
        title: of the window.
        fps: pictures per second that it shows at most: it waits, so that flight is in real time.

    Raises:
        RuntimeError: there is no display, or no toolkit that could use it.
    """

    def __init__(self, title: str, fps: float) -> None:
        import matplotlib as mpl
        from matplotlib import pyplot

        self._pyplot: Any = pyplot
        backend = str(pyplot.get_backend()).lower()
        if backend in _FILES_ONLY:
            raise RuntimeError(
                "render_mode='human' opens a window, but matplotlib finds no display or no toolkit "
                f"(its backend is {backend!r}); use render_mode='rgb_array', or on a desktop "
                "install Tk or `pip install PySide6`"
            )
        with mpl.rc_context({"toolbar": "None"}):
            self._figure = pyplot.figure(title, figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
        self._axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._image: Any = None
        self._between_s, self._due = 1.0 / fps, 0.0

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3) until the next."""
        if self._image is None:
            self._image = self._axes.imshow(picture, interpolation="antialiased")
            self._figure.show()
        sleep(max(0.0, self._due - perf_counter()))
        self._due = perf_counter() + self._between_s
        self._image.set_data(picture)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()

    def close(self) -> None:
        """Close the window. May be called more than once."""
        self._pyplot.close(self._figure)
