"""References of every task in one compiled call: rest, straight lines, ellipses.

The same motions as those of `swarm_envs.trajectories`, for all drones of all environments at once,
since each decision asks for them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.state import FloatArray
from swarm_envs.tasks.mission import Mission
from swarm_envs.trajectories import Reference

REST, LINES, ORBITS = 0, 1, 2
"""Kinds of motion."""
_ROUNDING = 1e-9


class Motion(NamedTuple):
    """How a task's reference moves."""

    kind: int = REST
    """`REST` at the goals; `LINES`: straight from each stage's goals to the next, where the
    mission has a duration; `ORBITS`: on the mission's ellipses."""
    ramp: float = 0.2
    """`LINES`: share of the duration in which the speed grows, and in which it falls. `ORBITS`:
    time in which the rate grows from rest, s."""
    stage_s: float = 0.0
    """Seconds that each stage lasts; 0 if there is only one."""


@borrowing_kernel
def stage_at(time: float, stage_s: float, num_stages: int) -> int:
    """The stage that is flown at a time, s."""
    if num_stages == 1 or stage_s <= 0.0:
        return 0
    return min(int((time + _ROUNDING) / stage_s), num_stages - 1)


@borrowing_kernel
def ramped_time(t: float, ramp: float) -> tuple[float, float, float, float]:
    """Time that stands still before zero and runs at full rate after `ramp`, and its derivatives.

    The rate is a quintic step; see `swarm_envs.trajectories.ellipse`.
    """
    if t <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if ramp <= 0.0 or t >= ramp:
        return t - 0.5 * max(ramp, 0.0), 1.0, 0.0, 0.0
    x = t / ramp
    value = x**4 * (2.5 - 3.0 * x + x**2) * ramp
    first = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    second = 30.0 * x**2 * (1.0 - x) ** 2 / ramp
    third = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
    return value, first, second, third


@borrowing_kernel
def line_profile(t: float, duration: float, ramp: float) -> tuple[float, float, float, float]:
    """Share of a straight way that is covered at time t, s, and its derivatives by time.

    Args:
        t: since the start, s.
        duration: from start to goal, s.
        ramp: share of the duration that each of the two ramps of the speed takes.
    """
    u = min(max(t / duration, 0.0), 1.0)
    full = 1.0 - ramp
    if u > 0.5:
        s, d1, d2, d3 = ramped_time(1.0 - u, ramp)
        s, d2 = full - s, -d2
    else:
        s, d1, d2, d3 = ramped_time(u, ramp)
    return (
        s / full,
        d1 / (full * duration),
        d2 / (full * duration**2),
        d3 / (full * duration**3),
    )


@borrowing_kernel
def _write_rest(e: int, mission: Mission, motion: Motion, time: float, out: Reference) -> None:
    stage = stage_at(time, motion.stage_s, mission.goals.shape[1])
    for i in range(mission.goals.shape[2]):
        for k in range(3):
            out.position[e, i, k] = mission.goals[e, stage, i, k]
            out.velocity[e, i, k] = out.acceleration[e, i, k] = out.jerk[e, i, k] = 0.0


@borrowing_kernel
def _write_lines(e: int, mission: Mission, motion: Motion, time: float, out: Reference) -> None:
    stage = stage_at(time, motion.stage_s, mission.goals.shape[1])
    since = time - stage * motion.stage_s
    s, d1, d2, d3 = line_profile(since, mission.duration[e], motion.ramp)
    start = mission.start[e] if stage == 0 else mission.goals[e, stage - 1]
    goal = mission.goals[e, stage]
    for i in range(goal.shape[0]):
        for k in range(3):
            way = goal[i, k] - start[i, k]
            # Weighted so that the end is met to the last bit.
            out.position[e, i, k] = start[i, k] * (1.0 - s) + goal[i, k] * s
            out.velocity[e, i, k] = d1 * way
            out.acceleration[e, i, k] = d2 * way
            out.jerk[e, i, k] = d3 * way


@borrowing_kernel
def _write_orbits(e: int, mission: Mission, ramp: float, time: float, out: Reference) -> None:
    warp, d1, d2, d3 = ramped_time(time, ramp)
    for i in range(mission.rate.shape[1]):
        rate = mission.rate[e, i]
        angle = mission.phase[e, i] + rate * warp
        c, s = math.cos(angle), math.sin(angle)
        w, dw, ddw = rate * d1, rate * d2, rate * d3
        for k in range(3):
            a, b = mission.orbit[e, i, 1, k], mission.orbit[e, i, 2, k]
            radial, tangent = a * c + b * s, b * c - a * s
            out.position[e, i, k] = mission.orbit[e, i, 0, k] + radial
            out.velocity[e, i, k] = tangent * w
            out.acceleration[e, i, k] = tangent * dw - radial * w**2
            out.jerk[e, i, k] = tangent * (ddw - w**3) - 3.0 * radial * w * dw


@borrowing_kernel
def write_reference(mission: Mission, motion: Motion, time: FloatArray, out: Reference) -> None:
    """Write where the drones of every environment should be.

    Args:
        mission: starts, goals and ellipses.
        motion: how the reference moves.
        time: (E,) s.
        out: arrays (E, N, 3), written.
    """
    for e in range(time.shape[0]):
        if motion.kind == ORBITS:
            _write_orbits(e, mission, motion.ramp, time[e], out)
        elif motion.kind == LINES and mission.duration[e] > 0.0:
            _write_lines(e, mission, motion, time[e], out)
        else:
            _write_rest(e, mission, motion, time[e], out)


def new_reference(num_envs: int, num_drones: int) -> Reference:
    """A reference whose arrays (E, N, 3) are zero."""
    return Reference(*(np.zeros((num_envs, num_drones, 3)) for _ in range(4)))
