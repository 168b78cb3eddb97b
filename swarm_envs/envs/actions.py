"""Action modes: the meaning of an action, and its conversion to set-points or rotor commands.

| mode | numbers | meaning |
|---|---|---|
| `acceleration` | 3 in [-1, 1] | acceleration of the set-point over 5 m/s^2; see `accelerate` |
| `velocity` | 3 in [-1, 1] | velocity of the set-point over 2 m/s; see `approach_velocity` |
| `ctbr` | 4 in [-1, 1] | collective thrust, zero to maximum; body rates about x, y, z |
| `rotors` | 4 in [-1, 1] | thrust of each rotor, zero to maximum |
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
"""Time constant with which a set-point's acceleration approaches the commanded one, s."""

TILT_RATE_LIMIT, YAW_RATE_LIMIT = 8.0, 4.0
"""Largest body rates of `ctbr` about x and y, and about z, rad/s."""

_ROUNDING = 1e-6
_LARGEST = 1e30
"""Largest number in an unbounded Box; with larger ones, float32 observations would overflow."""
_ACCELERATION, _VELOCITY, _CTBR, _ROTORS, _SETPOINT = range(5)


@dataclass(frozen=True)
class ActionMode:
    """An action mode."""

    name: str  # A value of the option `action`
    code: int  # The mode's number in kernels
    width: int  # Numbers per drone
    level: int
    """The input of the control loop: SETPOINTS, RATES or ROTORS of `swarm_envs.physics.step`."""
    limit: float = 1.0 + _ROUNDING  # Largest absolute value of a number

    @property
    def bounded(self) -> bool:
        """True if numbers must lie in [-1, 1]."""
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
"""All action modes by name."""


@part
def accelerate(drone: Record, x: float, y: float, z: float, decision_s: float) -> None:
    """Set the jerk with which a set-point's acceleration approaches the commanded one.

    If a set-point's acceleration decays with time constant tau, its velocity tends to
    u = v + tau a, which changes at the commanded acceleration. u is kept within the speed limit,
    and thereby v. During the decision the acceleration is a linear ramp (trapezoidal rule), which
    the attitude can follow.

    Args:
        drone: the drone's record; `setpoint_jerk` is written, constant until the next decision.
        x: x component of the action, in [-1, 1], times 5 m/s^2.
        y: y component.
        z: z component.
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
    """Return the acceleration, over 5 m/s^2, that brings a set-point to the commanded velocity.

    The velocity is reached by the next decision, or as soon as 5 m/s^2 allow. The commanded
    velocity is kept within the speed limit. The arguments are those of `accelerate`, times 2 m/s.
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
    """Write an action (width,) of mode `ctbr`, `rotors` or `setpoint` into a drone's record."""
    most = drone.nominal_max_rotor_thrust
    if code == _CTBR:
        drone.ctbr[0] = 0.5 * (u[0] + 1.0) * (4.0 * most)
        drone.ctbr[1], drone.ctbr[2] = (
            TILT_RATE_LIMIT * u[1],
            TILT_RATE_LIMIT * u[2],
        )
        drone.ctbr[3] = YAW_RATE_LIMIT * u[3]
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
    """Write actions into the set-points or commands of running environments; advance their time.

    Args:
        code: code of the action mode.
        actions: (E, N, width).
        limit: largest absolute value of a number.
        drones: (E, N) records.
        environments: (E,) records; their time becomes that at the end of the decision.
        settings: (1,) record.
        flown: (E,) mask of the environments that run, written.

    Returns:
        True if every number is finite and within the limit. Otherwise nothing was changed.
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
    """Return actions (E, N, width) as contiguous float64, with `clip` clipped to a bounded Box.

    Raises:
        ValueError: the actions are no numbers, or have another shape.
    """
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
        finite = np.isfinite(array)  # infinity is rejected, not clipped
        array = np.clip(array, -1.0, 1.0, out=array.copy(), where=finite)
    return array


def check_actions(mode: ActionMode, actions: FloatArray) -> None:
    """Raise ValueError for actions (E, N, width) outside the mode's Box."""
    limit = mode.limit
    wrong = ~np.isfinite(actions)
    rule, fix = "every number must be finite", "check the policy's output"
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
