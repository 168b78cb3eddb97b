"""Actions: what an agent's numbers mean, and how they reach set-points or rotors.

| mode | numbers | meaning |
|---|---|---|
| `acceleration` | 3 in [-1, 1] | acceleration of the set-point over 5 m/s^2; see `accelerate` |
| `velocity` | 3 in [-1, 1] | velocity of the set-point over 2 m/s; see `approach_velocity` |
| `ctbr` | 4 in [-1, 1] | collective thrust, from none to the largest; body rates about x, y, z |
| `rotors` | 4 in [-1, 1] | thrust of each rotor, from none to the largest |
| `setpoint` | 14, SI | position, velocity, acceleration, jerk (3 each), yaw, yaw rate |
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import kernel, part
from swarm_envs.physics.step import RATES, ROTORS, SETPOINTS
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Record, Records
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT

__all__ = ["ACCELERATION_LAG", "ACTIONS"]

ACCELERATION_LAG = 0.1
"""Time constant with which a set-point's acceleration approaches what is asked for, s."""

TILT_RATE_LIMIT, YAW_RATE_LIMIT = 8.0, 4.0
"""Largest body rates that `ctbr` asks for, about x and y, and about z, rad/s."""

_ROUNDING = 1e-6
_LARGEST = 1e30
"""Of numbers in an unbounded Box: further, float32 observations could not hold what follows."""
_ACCELERATION, _VELOCITY, _CTBR, _ROTORS, _SETPOINT = range(5)


@dataclass(frozen=True)
class ActionMode:
    """One meaning of actions."""

    name: str  # As the option `action` names it
    code: int  # As kernels tell modes apart
    width: int  # Numbers per drone
    level: int
    """Where in the loop it enters: SETPOINTS, RATES or ROTORS of `swarm_envs.physics.step`."""
    limit: float = 1.0 + _ROUNDING  # Largest size of a number

    @property
    def bounded(self) -> bool:
        """Whether numbers must lie in [-1, 1]."""
        return self.limit < _LARGEST


ACTIONS: dict[str, ActionMode] = {
    mode.name: mode
    for mode in (
        ActionMode("acceleration", _ACCELERATION, 3, SETPOINTS),
        ActionMode("velocity", _VELOCITY, 3, SETPOINTS),
        ActionMode("ctbr", _CTBR, 4, RATES),
        ActionMode("rotors", _ROTORS, 4, ROTORS),
        ActionMode("setpoint", _SETPOINT, 14, SETPOINTS, _LARGEST),
    )
}
"""Every action mode by name."""


@part
def accelerate(drone: Record, x: float, y: float, z: float, decision_s: float) -> None:
    """Let a set-point's acceleration approach what is asked for, within the speed limit.

    With time constant tau the velocity that a set-point coasts to, u = v + tau a, moves at the
    acceleration asked for; u is kept within the speed limit, and so v is. Over the decision the
    acceleration is a straight ramp (the trapezoidal rule), so the attitude can follow.

    Args:
        drone: its record; the set-point's jerk is set, constant until the next decision.
        x: action, in [-1, 1], times 5 m/s^2.
        y: the same.
        z: the same.
        decision_s: time until the next decision, s.
    """
    v, a, coast = drone.setpoint_velocity, drone.setpoint_acceleration, drone.setpoint_jerk
    tau = max(ACCELERATION_LAG, 0.5 * decision_s)
    coast[0] = v[0] + tau * a[0] + ACCELERATION_LIMIT * x * decision_s
    coast[1] = v[1] + tau * a[1] + ACCELERATION_LIMIT * y * decision_s
    coast[2] = v[2] + tau * a[2] + ACCELERATION_LIMIT * z * decision_s
    square = coast[0] * coast[0] + coast[1] * coast[1] + coast[2] * coast[2]
    scale = min(1.0, SPEED_LIMIT / np.sqrt(square)) if square > 0.0 else 1.0
    for k in range(3):
        gained = scale * coast[k] - v[k] - 0.5 * decision_s * a[k]
        coast[k] = (gained / (tau + 0.5 * decision_s) - a[k]) / decision_s


@part
def approach_velocity(
    drone: Record, x: float, y: float, z: float, decision_s: float
) -> tuple[float, float, float]:
    """Acceleration, over 5 m/s^2, that brings a set-point to the velocity asked for.

    By the next decision if 5 m/s^2 suffice, else as fast as these do. The velocity asked for is
    kept within the speed limit. Arguments as of `accelerate`, but times 2 m/s.
    """
    v, a = drone.setpoint_velocity, drone.setpoint_acceleration
    tau = max(ACCELERATION_LAG, 0.5 * decision_s)
    scale = SPEED_LIMIT / max(np.sqrt(x * x + y * y + z * z), 1.0)
    most = ACCELERATION_LIMIT * decision_s
    gx = (scale * x - (v[0] + tau * a[0])) / most
    gy = (scale * y - (v[1] + tau * a[1])) / most
    gz = (scale * z - (v[2] + tau * a[2])) / most
    shrink = 1.0 / max(np.sqrt(gx * gx + gy * gy + gz * gz), 1.0)
    return shrink * gx, shrink * gy, shrink * gz


@part
def write_command(drone: Record, code: int, u: FloatArray) -> None:
    """Write an action (width,), neither acceleration nor velocity, into a drone's record."""
    most = drone.nominal_max_rotor_thrust
    if code == _CTBR:
        drone.asked[0] = 0.5 * (u[0] + 1.0) * (4.0 * most)
        drone.asked[1], drone.asked[2] = TILT_RATE_LIMIT * u[1], TILT_RATE_LIMIT * u[2]
        drone.asked[3] = YAW_RATE_LIMIT * u[3]
    elif code == _ROTORS:
        for k in range(4):
            drone.commands[k] = 0.5 * (u[k] + 1.0) * most
    else:
        for k in range(3):
            drone.setpoint_position[k], drone.setpoint_velocity[k] = u[k], u[3 + k]
            drone.setpoint_acceleration[k], drone.setpoint_jerk[k] = u[6 + k], u[9 + k]
        drone.setpoint_yaw, drone.setpoint_yaw_rate = u[12], u[13]


@kernel
def apply_actions(
    code: int,
    actions: FloatArray,
    limit: float,
    drones: Records,
    environments: Records,
    settings: Records,
    flown: BoolArray,
) -> bool:
    """Write actions into the set-points or commands of the environments that run, and tell time.

    Args:
        code: of the action mode.
        actions: (E, N, width).
        limit: largest size of a number.
        drones: (E, N) records.
        environments: (E,) records, whose time is that after the decision.
        settings: (1,) record.
        flown: (E,) which environments run, written.

    Returns:
        Whether every number is finite and within the limit; if not, nothing was changed.
    """
    for e in range(actions.shape[0]):
        for i in range(actions.shape[1]):
            for k in range(actions.shape[2]):
                if not abs(actions[e, i, k]) <= limit:
                    return False
    rate, decision_s = settings[0].decision_rate, settings[0].decision_s
    for e in range(actions.shape[0]):
        flown[e] = environments[e].running
        if not flown[e]:
            continue
        environments[e].decisions += 1
        environments[e].time = environments[e].decisions / rate
        for i in range(actions.shape[1]):
            u, d = actions[e, i], drones[e, i]
            if code > _VELOCITY:
                write_command(d, code, u)
                continue
            x, y, z = u[0], u[1], u[2]
            if code == _VELOCITY:
                x, y, z = approach_velocity(d, x, y, z, decision_s)
            accelerate(d, x, y, z, decision_s)
    return True


def as_actions(
    mode: ActionMode, actions: npt.ArrayLike, shape: tuple[int, int, int], clip: bool = False
) -> FloatArray:
    """Actions (E, N, width) as contiguous float64, clipped to a bounded mode's Box if wanted."""
    try:
        array: FloatArray = np.ascontiguousarray(actions, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"actions are {actions!r:.80}, but must be numbers, {shape}") from error
    if array.shape != shape:
        raise ValueError(
            f"actions have shape {array.shape}, but must have shape {shape}: environments, drones, "
            f"numbers of action {mode.name!r}"
        )
    if clip and mode.bounded:
        finite = np.isfinite(array)  # infinity is refused, not clipped
        array = np.clip(array, -1.0, 1.0, out=array.copy(), where=finite)
    return array


def check_actions(mode: ActionMode, actions: FloatArray) -> None:
    """Refuse actions (E, N, width) that the mode's Box excludes."""
    limit = mode.limit
    wrong = ~np.isfinite(actions)
    rule, fix = "every number must be finite", "look for what made it so"
    if not wrong.any():
        wrong = np.abs(actions) > limit
        edge = 1 if mode.bounded else f"{_LARGEST:g}"
        rule = f"must lie in [-{edge}, {edge}]"
        fix = f"clip it, as with np.clip(action, -{edge}, {edge})"
        fix += ", or give clip_actions=True" if mode.bounded else ""
    if not wrong.any():
        return
    e, i, k = (int(n) for n in np.argwhere(wrong)[0])
    where = f" in environment {e}" if len(actions) > 1 else ""
    raise ValueError(
        f"action {mode.name!r} of drone_{i}{where} has {actions[e, i, k]:.8g} at index {k}, but "
        f"{rule}; {fix}"
    )
