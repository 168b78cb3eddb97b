"""Smoother flights of up to about a thousand robots: corridors and quadratic programs.

After Hoenig et al. 2018, whose corridors are separating planes: each robot's control points are
moved to lower acceleration and jerk within planes that move half way between it and the others, and
all robots at once, for the planes are shared. The flight before is a solution of every program, so
no round makes it less safe; a robot whose program fails keeps its way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import osqp
from scipy import sparse
from tqdm import tqdm

from swarm_envs.baselines.rth3d.flight.planes import (
    BEZIER,
    Planes,
    joined,
    planes_between,
    planes_to_boxes,
)
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight
from swarm_envs.state import FloatArray

_TOLERANCE = 1e-6
_FIXED = 3
"""Control points at either end that stay: the robot rests there."""


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
        if self.rounds < 1 or self.jerk_weight < 0.0:
            raise ValueError("rounds must be at least 1, and jerk_weight not negative")


def smooth(flight: SplineFlight, config: SmoothingConfig, progress: bool = False) -> SplineFlight:
    """A flight on the same vertices' way with less acceleration, and no longer than before.

    Args:
        flight: valid, such as `on_grid` makes it.
        config: see there.
        progress: show a progress bar.

    Returns:
        The flight at the shortest step that keeps speed and acceleration.
    """
    if flight.num_steps <= _FIXED:
        return flight
    total = config.rounds * flight.num_robots
    with tqdm(total=total, desc="smoothing", unit="robot", disable=not progress) as bar:
        for _ in range(config.rounds):
            flight = _round(flight, config, bar)
    return faster(flight, config.speed, config.acceleration)


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
    control, hessian = flight.control.copy(), _hessian(len(flight.control), config.jerk_weight)
    for i in range(flight.num_robots):
        own = together.some(slice(bounds[i], bounds[i + 1]))
        control[:, i] = _solve(flight.control[:, i], own, hessian, config)
        bar.update()
    return replace(flight, control=control)


def _hessian(count: int, jerk_weight: float) -> sparse.csc_matrix:
    """Of the summed squares of second and third differences of so many control points."""
    eye = np.eye(count)
    second, third = np.diff(eye, n=2, axis=0), np.diff(eye, n=3, axis=0)
    return sparse.csc_matrix(second.T @ second + jerk_weight * (third.T @ third))


def _solve(
    control: FloatArray, planes: Planes, hessian: sparse.csc_matrix, config: SmoothingConfig
) -> FloatArray:
    """Better control points (K, 3) of one robot within its planes, or the same."""
    count = len(control)
    rows = _rows(planes, count)
    low = np.minimum(np.array(config.box[0]), control.min(axis=0))
    high = np.maximum(np.array(config.box[1]), control.max(axis=0))
    least = np.maximum(low, control - config.travel)
    most = np.minimum(high, control + config.travel)
    for held in (slice(None, _FIXED), slice(-_FIXED, None)):
        least[held] = most[held] = control[held]
    lower = np.concatenate([least.ravel(), planes.offset.ravel()])
    upper = np.concatenate([most.ravel(), np.full(planes.offset.size, np.inf)])
    matrix = sparse.vstack([sparse.eye(3 * count), rows], format="csc")
    solver = osqp.OSQP()
    solver.setup(
        sparse.kron(hessian, sparse.eye(3), format="csc"),
        np.zeros(3 * count),
        matrix,
        lower,
        upper,
        eps_abs=1e-5,
        eps_rel=1e-5,
        max_iter=4000,
        polishing=True,
        verbose=False,
    )
    solver.warm_start(x=control.ravel())
    found = solver.solve(raise_error=False).x
    return _accepted(control, found, matrix, lower, upper)


def _accepted(
    control: FloatArray,
    found: FloatArray | None,
    matrix: sparse.csc_matrix,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray:
    """The solution drawn towards the old way until every row holds: that one satisfies them all."""
    if found is None or not np.isfinite(found).all():
        return control
    better = found.reshape(control.shape).copy()
    better[:_FIXED], better[-_FIXED:] = control[:_FIXED], control[-_FIXED:]
    for share in (1.0, 0.999, 0.99, 0.9, 0.5):
        trial = control + share * (better - control)
        value = matrix @ trial.ravel()
        if (value >= lower - _TOLERANCE).all() and (value <= upper + _TOLERANCE).all():
            return np.asarray(trial)
    return control


def _rows(planes: Planes, count: int) -> sparse.csc_matrix:
    """(4 P, 3 K) what each plane says of each of its four Bezier points."""
    size = len(planes.step)
    weights = np.einsum("bk,px->pbkx", BEZIER, planes.normal)
    row = np.broadcast_to(np.arange(4 * size).reshape(size, 4, 1, 1), weights.shape)
    point = planes.step[:, None] + np.arange(4)
    column = 3 * point[:, None, :, None] + np.arange(3)
    where = row.ravel(), np.broadcast_to(column, weights.shape).ravel()
    return sparse.csc_matrix((weights.ravel(), where), shape=(4 * size, 3 * count))
