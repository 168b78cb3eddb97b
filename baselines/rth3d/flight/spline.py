"""Smooth flights along paths on a grid: uniform cubic B-splines with vertices as control points.

Acceleration is continuous and jerk is constant within a step, so that one setpoint per step
describes the flight fully. A robot never leaves the convex hull of four consecutive vertices of its
path; the least distance of robots depends on the spacing alone (`clearance`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from swarm_envs.errors import check_array
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference

__all__ = ["shortest_step"]

DEGREE = 3  # The degree of the splines
BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Weights of the four control points of a step, with a row for each power of u."""
_DERIVATIVE = (
    np.array([0.0, 1.0, 2.0, 3.0]),
    np.array([0.0, 0.0, 2.0, 6.0]),
    np.array([0.0, 0.0, 0.0, 6.0]),
)


@dataclass(frozen=True, eq=False)
class SplineFlight:
    """Uniform cubic B-splines of n robots that begin and end at rest.

    Args:
        control: The control points (K, n, 3), m, at least four; the first three are equal, and so
            are the last three.
        step_s: The duration of a step, s.

    Raises:
        ValueError: There are too few or infinite control points, a start or an end is not at rest,
            or the duration is not positive.
    """

    control: FloatArray
    step_s: float

    def __post_init__(self) -> None:
        if np.ndim(self.control) != 3 or len(self.control) < DEGREE + 1:
            raise ValueError(
                f"control points have shape {np.shape(self.control)}, but must be (K, n, 3) with K "
                "of at least 4"
            )
        control = check_array("control", self.control, (*np.shape(self.control)[:2], 3)).copy()
        for name, ends in (("first", control[:3]), ("last", control[-3:])):
            if not (ends == ends[0]).all():
                raise ValueError(f"the {name} three control points differ, but must be equal")
        if not 0.0 < self.step_s < math.inf:
            raise ValueError(f"step_s is {self.step_s!r}, but must be positive and finite")
        control.flags.writeable = False
        object.__setattr__(self, "control", control)

    @property
    def num_robots(self) -> int:
        """The number of robots (n)."""
        return self.control.shape[1]

    @property
    def num_steps(self) -> int:
        """The number of steps, each of constant jerk."""
        return len(self.control) - DEGREE

    @property
    def duration_s(self) -> float:
        """The duration from rest to rest, s."""
        return self.num_steps * self.step_s

    def reference(self, time: float) -> Reference:
        """Return the robots' reference at a time since the start, s; at rest outside the flight."""
        if not 0.0 < time < self.duration_s:
            end = self.control[0 if time <= 0.0 else -1]
            still = np.zeros_like(end)
            return Reference(end.copy(), still, still.copy(), still.copy())
        step = min(int(time / self.step_s + 1e-9), self.num_steps - 1)
        u = time / self.step_s - step
        piece = np.tensordot(BASIS, self.control[step : step + 4], axes=1)
        powers = np.array([1.0, u, u * u, u**3])
        parts = [np.tensordot(powers, piece, axes=1)]
        for k, factors in enumerate(_DERIVATIVE, start=1):
            lowered = np.concatenate([np.zeros(k), powers[:-k]])
            parts.append(np.tensordot(factors * lowered, piece, axes=1) / self.step_s**k)
        return Reference(*parts)

    def largest(self) -> tuple[float, float, float]:
        """Return the largest speed, m/s, acceleration, m/s^2, and jerk, m/s^3, by axis.

        The speed is an upper bound, by its control points; the others are exact.
        """
        differences = [np.diff(self.control, n=k, axis=0) / self.step_s**k for k in (1, 2, 3)]
        speed, acceleration, jerk = (float(np.abs(d).max(initial=0.0)) for d in differences)
        return speed, acceleration, jerk


def shortest_step(spacing: FloatArray, speed: float, acceleration: float) -> float:
    """Return the shortest step, s, with which any path on a grid is within bounds by axis.

    A path moves along one axis per step, so that control points of the speed are at most a spacing,
    those of the acceleration at most two spacings (a turn back). SI units.
    """
    widest = float(np.max(spacing))
    return max(widest / speed, math.sqrt(2.0 * widest / acceleration))
