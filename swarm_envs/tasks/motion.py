"""Kernels that write the references of tasks: rest, straight lines, ellipses.

Lines are those of `swarm_envs.trajectories.ramped_line`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.state import FloatArray
from swarm_envs.tables import Records
from swarm_envs.trajectories import Reference

__all__ = ["LINES", "ORBITS", "REST", "Motion", "reference_of"]

SPEED_LIMIT, ACCELERATION_LIMIT = 2.0, 5.0
"""Largest commanded speed and acceleration, m/s and m/s^2, the same for every vehicle type."""

REST, LINES, ORBITS, OWN_GOALS, PURSUIT = 0, 1, 2, 3, 4
"""Kinds of motion."""
_ROUNDING = 1e-9


class Motion(NamedTuple):
    """The motion of a task's reference."""

    kind: int = REST
    """`REST`: at rest at the goals; `LINES`: straight from each stage's goals to the next, in the
    episode's `duration`; `ORBITS`: on the drones' ellipses; `OWN_GOALS`: at rest at each drone's
    present goal; `PURSUIT`: goals move on ellipses, or next to other drones."""
    ramp: float = 0.2
    """`LINES`: share of the duration in which the speed grows, and in which it falls. `ORBITS` and
    `PURSUIT`: time in which the angular rate grows from 0, s."""
    stage_s: float = 0.0
    """Time for each stage, s; 0 if there is only one."""

    @property
    def rests(self) -> bool:
        """True if the reference rests at the goal."""
        return self.kind in (REST, OWN_GOALS)

    def settings(self) -> dict[str, float]:
        """Return its fields of `swarm_envs.tables.SETTINGS`."""
        return {"ramp": float(self.ramp), "stage_s": float(self.stage_s)}


@part
def stage_at(time: float, stage_s: float, num_stages: int) -> int:
    """Return the stage at a time, s."""
    if stage_s <= 0.0:
        return 0
    stage: Any = np.int64((time + _ROUNDING) / stage_s)  # `int` and `min` take longer to compile
    return stage if stage < num_stages else num_stages - 1


@part
def ramped_time(t: float, ramp: float) -> tuple[float, float, float, float]:
    """Return a time that runs at rate 0 before t = 0 and at rate 1 after `ramp`; 3 derivatives.

    The rate is a quintic step between them, so that the jerk is continuous.
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


@part
def line_profile(t: float, duration: float, ramp: float) -> tuple[float, float, float, float]:
    """Return the covered share of a straight line at time t, s, and its time derivatives.

    Args:
        t: time since the start, s.
        duration: time from start to goal, s.
        ramp: share of the duration of each of the two ramps of the speed.
    """
    u = min(max(t / duration, 0.0), 1.0)
    full = 1.0 - ramp
    if u > 0.5:
        s, d1, d2, d3 = ramped_time(1.0 - u, ramp)
        s, d2 = full - s, -d2
    else:
        s, d1, d2, d3 = ramped_time(u, ramp)
    return (s / full, d1 / (full * duration), d2 / (full * duration**2), d3 / (full * duration**3))


@kernel
def write_rest(
    drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Write references at rest at the goals of each environment's stage.

    Args:
        drones: (E, N) records; their `reference_...` fields are written.
        environments: (E,) records.
        goals: (E, S, N, 3) goals of every stage, m.
        settings: (1,) record with `stage_s` and `ramp`.
    """
    stage_s, stages = settings[0].stage_s, goals.shape[1]
    for e in range(drones.shape[0]):
        stage = stage_at(environments[e].time, stage_s, stages) if stages > 1 else 0
        for i in range(drones.shape[1]):
            d = drones[e, i]
            for k in range(3):
                d.reference_position[k] = goals[e, stage, i, k]
                d.reference_velocity[k] = d.reference_acceleration[k] = d.reference_jerk[k] = 0.0


@kernel
def write_lines(
    drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Write references on straight lines from the goals of each stage to those of the next.

    With a duration of 0 they rest at the goals. The arguments are those of `write_rest`.
    """
    ramp, stage_s, stages = settings[0].ramp, settings[0].stage_s, goals.shape[1]
    for e in range(drones.shape[0]):
        time, duration = environments[e].time, environments[e].duration
        stage = stage_at(time, stage_s, stages) if stages > 1 else 0
        s, d1, d2, d3 = 1.0, 0.0, 0.0, 0.0
        if duration > 0.0:
            s, d1, d2, d3 = line_profile(time - stage * stage_s, duration, ramp)
        for i in range(drones.shape[1]):
            d = drones[e, i]
            for k in range(3):
                goal = goals[e, stage, i, k]
                start = d.start[k] if stage == 0 else goals[e, stage - 1, i, k]
                path = goal - start
                # Weighted so that the end is reached to the last bit
                d.reference_position[k] = start * (1.0 - s) + goal * s
                d.reference_velocity[k] = d1 * path
                d.reference_acceleration[k] = d2 * path
                d.reference_jerk[k] = d3 * path


@kernel
def write_orbits(
    drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Write references on the drones' ellipses. The arguments are those of `write_rest`."""
    for e in range(drones.shape[0]):
        s, d1, d2, d3 = ramped_time(environments[e].time, settings[0].ramp)
        for i in range(drones.shape[1]):
            d = drones[e, i]
            rate = d.orbit_rate
            angle, w, dw, ddw = d.orbit_phase + rate * s, rate * d1, rate * d2, rate * d3
            cos, sin = math.cos(angle), math.sin(angle)
            for k in range(3):
                a, b = d.orbit[1, k], d.orbit[2, k]
                radial, tangent = a * cos + b * sin, b * cos - a * sin
                d.reference_position[k] = d.orbit[0, k] + radial
                d.reference_velocity[k] = tangent * w
                d.reference_acceleration[k] = tangent * dw - radial * w**2
                d.reference_jerk[k] = tangent * (ddw - w**3) - 3.0 * radial * w * dw


@kernel
def write_own_goals(
    drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Write references at rest at the present goals. The arguments are those of `write_rest`."""
    for e in range(drones.shape[0]):
        for i in range(drones.shape[1]):
            d = drones[e, i]
            for k in range(3):
                d.reference_position[k] = d.goal[k]
                d.reference_velocity[k] = d.reference_acceleration[k] = d.reference_jerk[k] = 0.0


@kernel
def write_pursuit(
    drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Write goals on ellipses or, if a drone chases another, next to that one.

    The goal of a drone that chases another is the center of its ellipse, relative to the other
    drone. Its reference has the velocity of the other drone, and no acceleration, which is not
    observed. The arguments are those of `write_rest`.
    """
    write_orbits(drones, environments, goals, settings)
    for e in range(drones.shape[0]):
        for i in range(drones.shape[1]):
            d = drones[e, i]
            for k in range(3):
                if d.chased >= 0.0:
                    other = drones[e, int(d.chased)]
                    d.reference_position[k] = other.position[k] + d.orbit[0, k]
                    d.reference_velocity[k] = other.velocity[k] * other.active
                d.goal[k] = d.reference_position[k]


WRITERS = {
    REST: write_rest,
    LINES: write_lines,
    ORBITS: write_orbits,
    OWN_GOALS: write_own_goals,
    PURSUIT: write_pursuit,
}
"""The kernels by kind of motion; only the task's own is compiled."""


def reference_of(drones: Records) -> Reference:
    """Return the references of drones (E, N), as last written: views (E, N, 3)."""
    return Reference(*(drones[f"reference_{name}"] for name in Reference._fields))
