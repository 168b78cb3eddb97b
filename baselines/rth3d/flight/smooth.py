"""Smoother flights of up to about a thousand robots: corridors and quadratic programs.

After Hoenig et al. 2018, whose corridors are separating planes: each robot's control points are
moved to lower acceleration and jerk within planes that move half way between it and the others, and
all robots at once, for the planes are shared. The flight before is a solution of every program, so
no round makes it less safe; a robot whose program fails keeps its way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from swarm_envs.arguments import typed
from swarm_envs.baselines.rth3d.flight.clearance import smallest_distance
from swarm_envs.baselines.rth3d.flight.planes import joined, planes_between, planes_to_boxes
from swarm_envs.baselines.rth3d.flight.program import FIXED, improve, smoothness
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight
from swarm_envs.errors import check_integer
from swarm_envs.state import FloatArray

_ROUNDING = 1e-5
"""By which robots may come closer, m: what planes are broken by."""


@typed
@dataclass(frozen=True, kw_only=True)
class SmoothingConfig:
    """How far and how often a flight is smoothed.

    Raises:
        ValueError: a number is out of range.
    """

    distance: float
    """Scaled distance that robots keep where they have it, m."""
    scaling: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Diagonal of Theta: distances are divided by it."""
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Corners of where robots may fly, m; widened to what the flight uses now."""
    obstacles: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()
    """Corners of boxes to keep clear of, m."""
    obstacle_distance: float = 0.1
    """Distance kept to them, m, where it is kept now."""
    travel: float = 0.25
    """How far a control point moves by axis in a round, m."""
    rounds: int = 5
    """How often."""
    jerk_weight: float = 1.0
    """Of squared third differences, beside squared second differences."""
    speed: float = 2.0
    """Largest speed by axis for the time a step takes at the end, m/s."""
    acceleration: float = 5.0
    """Largest acceleration by axis, m/s^2."""

    def __post_init__(self) -> None:
        """Check what the class says."""
        for name in ("distance", "obstacle_distance", "travel", "speed", "acceleration"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)!r}, but must be positive")
        check_integer("rounds", self.rounds, 1)
        if not 0.0 <= self.jerk_weight < np.inf:
            raise ValueError(f"jerk_weight is {self.jerk_weight!r}, but must be 0 or more")


@typed
def smooth(flight: SplineFlight, config: SmoothingConfig, progress: bool = False) -> SplineFlight:
    """A flight on the same vertices' way with less acceleration, and no longer than before.

    Args:
        flight: valid, such as `on_grid` makes it.
        config: see there.
        progress: show a progress bar.

    Returns:
        The flight at the shortest step that keeps speed and acceleration. Planes keep the hulls of
        the steps apart, which may be closer than the robots are: a round after which robots come
        closer than they did, and than `config.distance`, is only a step towards the next.
    """
    if flight.num_steps <= FIXED:
        return flight
    total, safe = config.rounds * flight.num_robots, flight
    kept = min(config.distance, smallest_distance(flight, config.scaling)) - _ROUNDING
    with tqdm(total=total, desc="smoothing", unit="robot", disable=not progress) as bar:
        for _ in range(config.rounds):
            flight = _round(flight, config, bar)
            if smallest_distance(flight, config.scaling) >= kept:
                safe = flight
    return faster(safe, config.speed, config.acceleration)


def faster(flight: SplineFlight, speed: float, acceleration: float) -> SplineFlight:
    """The flight with the shortest step that keeps speed, m/s, and acceleration, m/s^2, by axis."""
    fast, hard, _ = flight.largest()
    factor = max(fast / speed, (hard / acceleration) ** 0.5)
    return replace(flight, step_s=flight.step_s * factor) if factor > 0.0 else flight


def _round(flight: SplineFlight, config: SmoothingConfig, bar: tqdm) -> SplineFlight:
    scaling = np.array(config.scaling)
    boxes = np.array(config.obstacles, dtype=np.float64).reshape(-1, 2, 3)
    planes = (
        planes_between(flight, config.distance, scaling, config.travel),
        planes_to_boxes(flight, boxes, config.obstacle_distance, config.travel),
    )
    together = joined(planes)
    together = together.some(np.argsort(together.robot, kind="stable"))
    bounds = np.searchsorted(together.robot, np.arange(flight.num_robots + 1))
    cost = smoothness(len(flight.control), config.jerk_weight)
    control = flight.control.copy()
    for i in range(flight.num_robots):
        own = together.some(slice(bounds[i], bounds[i + 1]))
        control[:, i] = improve(flight.control[:, i], own, *_reach(flight, i, config), cost)
        bar.update()
    return replace(flight, control=control)


def _reach(
    flight: SplineFlight, robot: int, config: SmoothingConfig
) -> tuple[FloatArray, FloatArray]:
    """Bounds (F, 3) of a robot's free control points in a round."""
    control = flight.control[:, robot]
    low = np.minimum(np.array(config.box[0]), control.min(axis=0))
    high = np.maximum(np.array(config.box[1]), control.max(axis=0))
    free = control[FIXED:-FIXED]
    return np.maximum(low, free - config.travel), np.minimum(high, free + config.travel)
