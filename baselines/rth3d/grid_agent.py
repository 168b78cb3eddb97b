"""RTH3D as an agent: a plan on a grid for every set of goals, followed as a spline.

Starts and goals need not be on the grid: they are assigned to vertices with the least sum of
squared distances. The flight is checked before it begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from swarm_envs.agents.scripted import PlannedAgent
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.rth3d.flight.clearance import smallest_distance, worst_clearance
from swarm_envs.baselines.rth3d.flight.smooth import SmoothingConfig, faster, smooth
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight, shortest_step
from swarm_envs.baselines.rth3d.grid_planning import plan
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.view import View
from swarm_envs.errors import check_number, check_numbers
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, NEAR_MISS, SPEED_LIMIT, Task
from swarm_envs.tasks.obstacles import obstacle_distances, obstacle_rows

__all__ = ["GridAgent"]

MOST_SMOOTHED = 1000  # The most drones whose splines are smoothed
_SPACING_M = 0.4  # The least horizontal spacing
_OBSTACLE_M = 0.1  # The distance from obstacles and walls beyond the radius, m


@dataclass(frozen=True)
class Lattice:
    """A grid in space."""

    origin: FloatArray  # (3,) position of the vertex (0, 0, 0), m
    spacing: FloatArray  # (3,) m
    shape: tuple[int, int, int]  # Number of vertices by axis

    def points(self) -> FloatArray:
        """Return the positions (X, Y, Z, 3) of the vertices, m."""
        return self.origin + self.spacing * np.moveaxis(np.indices(self.shape), 0, -1)

    def near(self, points: FloatArray, free: BoolArray) -> IntArray:
        """Return a vertex (N, 3) for each point (N, 3) among the free ones (X, Y, Z).

        Raises:
            ValueError: There are fewer free vertices than points.
        """
        cells = np.argwhere(free)
        if len(cells) < len(points):
            raise ValueError(
                f"{len(points)} drones, but the grid {self.shape} in the arena has {len(cells)} "
                "free vertices; use a smaller spacing"
            )
        vertices = self.origin + self.spacing * cells
        square = ((points[:, None] - vertices) ** 2).sum(axis=-1)
        return np.asarray(cells[linear_sum_assignment(square)[1]])


class GridAgent(PlannedAgent[SplineFlight]):
    """An agent that plans every set of goals on a grid and follows the plan.

    Args:
        spacing: The spacing (x, y, z) of the grid, m, with which drones must keep 1.5 times the sum
            of their radii in any plan; None for 0.4 m, or more for large drones, and a quarter more
            in height.
        controller: The configuration of the tracking loop; None for its default, which assumes no
            interaction force.
        share: The share of a stage's duration that its flight takes, if limits allow.

    Raises:
        ValueError: A number is out of range.
    """

    def __init__(
        self,
        spacing: tuple[float, float, float] | None = None,
        controller: ControllerConfig | None = None,
        share: float = 0.7,
    ) -> None:
        if spacing is not None:
            check_numbers("spacing", spacing, 3, above=0.0)
        check_number("share", share, above=0.0, at_most=1.0)
        super().__init__({"action": "setpoint", "controller": controller or ControllerConfig()})
        self._spacing, self._share = spacing, share

    @classmethod
    def compensated(cls) -> GridAgent:
        """Return the agent over Neural-Swarm2's controller with `load_belief()`."""
        return cls(controller=ControllerConfig(feedforward=load_belief()))

    def plan(self, task: Task, view: View, seed: int) -> SplineFlight:
        """Return a smooth flight along paths on the grid, as slow as the stage allows.

        Raises:
            ValueError: The spacing is too small for the drones, there are too few vertices, or
                starts or goals are so close that drones come too close before the grid.
        """
        flight = self._fly(task, view.setpoint.position, view.goals, seed)
        stage_s = task.motion.stage_s or view.horizon_s
        slower = max(1.0, self._share * stage_s / flight.duration_s)
        return replace(flight, step_s=flight.step_s * slower)

    def _fly(self, task: Task, starts: FloatArray, goals: FloatArray, seed: int) -> SplineFlight:
        spacing = _usual_spacing(task) if self._spacing is None else np.array(self._spacing)
        lattice = _lattice(task, spacing)
        free = _free(task, lattice)
        found = plan(
            lattice.near(starts, free),
            lattice.near(goals, free),
            lattice.shape,
            obstacles=None if free.all() else ~free,
            seed=seed,
        )
        points = lattice.origin + lattice.spacing * found.paths
        control = np.concatenate([[starts] * 3, points, [goals] * 3])
        flight = SplineFlight(control, shortest_step(lattice.spacing, 1.0, 1.0))
        return _checked(task, flight)


def _usual_spacing(task: Task) -> FloatArray:
    """Return the spacing (3,), m, for the team's largest drones."""
    stretch = (1.0, 1.0, 1.25)
    needed = 1.05 * NEAR_MISS * 2.0 * float(task.radius.max()) / worst_clearance(stretch)
    return max(_SPACING_M, needed) * np.array(stretch)


def _lattice(task: Task, spacing: FloatArray) -> Lattice:
    touching = 2.0 * float(task.radius.max())
    stretch = spacing / spacing[0]
    kept = spacing[0] * worst_clearance((1.0, float(stretch[1]), float(stretch[2])))
    if kept < NEAR_MISS * touching:
        raise ValueError(
            f"at spacing {spacing.tolist()} m drones could come as close as {kept:.3f} m, but must "
            f"keep {NEAR_MISS * touching:.3f} m; use a wider spacing"
        )
    margin = touching / 2 + _OBSTACLE_M
    low, high = task.arena[0] + margin, task.arena[1] - margin
    cells = np.floor((high - low) / spacing + 1e-9).astype(int)
    origin = (low + high - cells * spacing) / 2
    return Lattice(origin, spacing, (int(cells[0]) + 1, int(cells[1]) + 1, int(cells[2]) + 1))


def _free(task: Task, lattice: Lattice) -> BoolArray:
    """Return True for vertices (X, Y, Z) that are clear of obstacles."""
    if not task.obstacles:
        return np.ones(lattice.shape, dtype=bool)
    gap = obstacle_distances(obstacle_rows(task.obstacles), lattice.points().reshape(-1, 3))
    clear = gap.min(axis=-1) > float(task.radius.max()) + _OBSTACLE_M
    return np.asarray(clear.reshape(lattice.shape))


def _checked(task: Task, flight: SplineFlight) -> SplineFlight:
    """Return the flight, smoothed and as fast as limits allow, if drones keep their distance."""
    least = NEAR_MISS * 2.0 * float(task.radius.max())
    close = smallest_distance(flight)
    if close < least:
        raise ValueError(
            f"between the grid and starts or goals, drones would come as close as {close:.3f} m, "
            f"but must keep {least:.3f} m; spread them, or use another spacing"
        )
    if flight.num_robots > MOST_SMOOTHED:
        return _clear(task, faster(flight, SPEED_LIMIT, ACCELERATION_LIMIT))
    margin = float(task.radius.max()) + _OBSTACLE_M
    low, high = task.arena[0] + margin, task.arena[1] - margin
    config = SmoothingConfig(
        distance=1.1 * least,
        box=((low[0], low[1], low[2]), (high[0], high[1], high[2])),
        obstacles=tuple(obstacle.corners for obstacle in task.obstacles),
        obstacle_distance=margin,
        speed=SPEED_LIMIT,
        acceleration=ACCELERATION_LIMIT,
    )
    return _clear(task, smooth(flight, config))


def _clear(task: Task, flight: SplineFlight) -> SplineFlight:
    if task.obstacles:
        times = np.linspace(0.0, flight.duration_s, 8 * flight.num_steps + 1)
        points = np.array([flight.reference(float(time)).position for time in times])
        gap = obstacle_distances(obstacle_rows(task.obstacles), points.reshape(-1, 3)).min()
        if gap < float(task.radius.max()):
            raise ValueError(
                f"the spline comes within {gap:.3f} m of an obstacle at a corner, but must keep "
                f"{float(task.radius.max()):.3f} m; use a smaller spacing"
            )
    return flight
