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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.borrowed import lend
from swarm_envs.compiled import borrowing_kernel, entry_point, kernel
from swarm_envs.control.state import Setpoint
from swarm_envs.envs.pilot import RATES, ROTORS, SETPOINTS, Pilot
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT

ACCELERATION_LAG = 0.1
"""Time constant with which a set-point's acceleration approaches what is asked for, s."""

TILT_RATE_LIMIT, YAW_RATE_LIMIT = 8.0, 4.0
"""Largest body rates that `ctbr` asks for, about x and y, and about z, rad/s."""

_ROUNDING = 1e-6
_LARGEST = 1e30
"""Of numbers in an unbounded Box: further, float32 observations could not hold what follows."""

Apply = Callable[[FloatArray, BoolArray], None]
"""Writes actions (E, N, width) into set-points or commands of a pilot, where running (E,)."""
Write = Callable[[FloatArray, Pilot, BoolArray, float], None]
"""The same, told the pilot and the time until the next decision, s."""


@dataclass(frozen=True)
class ActionMode:
    """One meaning of actions."""

    name: str
    """As the option `action` names it."""
    width: int
    """Numbers per drone."""
    bounded: bool
    """Whether numbers must lie in [-1, 1]."""
    level: int
    """Where in the loop it enters: SETPOINTS, RATES or ROTORS of `swarm_envs.envs.flight`."""
    bind: Callable[[Pilot, float], Apply]
    """What applies actions to this pilot, whose decisions last so many seconds."""


@borrowing_kernel
def accelerate(
    actions: FloatArray, setpoint: Setpoint, running: BoolArray, decision_s: float
) -> None:
    """Let the set-points' accelerations approach what is asked for, within the speed limit.

    With time constant tau the velocity that a set-point coasts to, u = v + tau a, moves at the
    acceleration asked for; u is kept within the speed limit, and so v is. Over the decision the
    acceleration is a straight ramp (the trapezoidal rule), so the attitude can follow.

    Args:
        actions: (E, N, 3) in [-1, 1], times 5 m/s^2.
        setpoint: changed in place: its jerk, constant until the next decision.
        running: (E,) environments to change.
        decision_s: time until the next decision, s.
    """
    velocity, acceleration, jerk = setpoint.velocity, setpoint.acceleration, setpoint.jerk
    tau = max(ACCELERATION_LAG, 0.5 * decision_s)
    for e in range(actions.shape[0]):
        if not running[e]:
            continue
        for i in range(actions.shape[1]):
            square, coast = 0.0, jerk[e, i]
            for k in range(3):
                asked = ACCELERATION_LIMIT * actions[e, i, k]
                coast[k] = velocity[e, i, k] + tau * acceleration[e, i, k] + asked * decision_s
                square += coast[k] * coast[k]
            scale = min(1.0, SPEED_LIMIT / np.sqrt(square)) if square > 0.0 else 1.0
            for k in range(3):
                now = acceleration[e, i, k]
                gained = scale * coast[k] - velocity[e, i, k] - 0.5 * decision_s * now
                jerk[e, i, k] = (gained / (tau + 0.5 * decision_s) - now) / decision_s


@kernel
def approach_velocity(
    actions: FloatArray, setpoint: Setpoint, running: BoolArray, decision_s: float
) -> FloatArray:
    """Accelerations, over 5 m/s^2, that bring the set-points to the velocities asked for.

    By the next decision if 5 m/s^2 suffice, else as fast as these do. The velocity asked for is
    kept within the speed limit.

    Args:
        actions: (E, N, 3) in [-1, 1], times 2 m/s.
        setpoint: as it is now.
        running: (E,) environments to look at.
        decision_s: time until the next decision, s.

    Returns:
        (E, N, 3) as `accelerate` takes them.
    """
    out, gap = np.zeros(actions.shape), np.empty(3)
    tau = max(ACCELERATION_LAG, 0.5 * decision_s)
    for e in range(actions.shape[0]):
        if not running[e]:
            continue
        for i in range(actions.shape[1]):
            size = 0.0
            for k in range(3):
                size += actions[e, i, k] * actions[e, i, k]
            scale = SPEED_LIMIT / max(np.sqrt(size), 1.0)
            square = 0.0
            for k in range(3):
                coast = setpoint.velocity[e, i, k] + tau * setpoint.acceleration[e, i, k]
                gap[k] = (scale * actions[e, i, k] - coast) / (ACCELERATION_LIMIT * decision_s)
                square += gap[k] * gap[k]
            shrink = 1.0 / max(np.sqrt(square), 1.0)
            for k in range(3):
                out[e, i, k] = shrink * gap[k]
    return out


def _accelerator(pilot: Pilot, decision_s: float) -> Apply:
    """The usual action, called without a look at its arguments' types: that would take longer."""
    setpoint, entry = lend(pilot.setpoint), None

    def apply(actions: FloatArray, running: BoolArray) -> None:
        nonlocal entry
        entry = entry or entry_point(accelerate, actions, setpoint, running, decision_s)
        entry(actions, setpoint, running, decision_s)

    return apply


def _velocity_keeper(pilot: Pilot, decision_s: float) -> Apply:
    apply = _accelerator(pilot, decision_s)
    return lambda actions, running: apply(
        approach_velocity(actions, pilot.setpoint, running, decision_s), running
    )


def _by_writing(write: Write) -> Callable[[Pilot, float], Apply]:
    return lambda pilot, decision_s: (
        lambda actions, running: write(actions, pilot, running, decision_s)
    )


def _write_ctbr(actions: FloatArray, pilot: Pilot, running: BoolArray, decision_s: float) -> None:
    given, most = actions[running], 4.0 * pilot.nominal.max_rotor_thrust[running]
    limits = np.array([TILT_RATE_LIMIT, TILT_RATE_LIMIT, YAW_RATE_LIMIT])
    pilot.asked[running, :, 0] = 0.5 * (given[..., 0] + 1.0) * most
    pilot.asked[running, :, 1:] = limits * given[..., 1:]


def _write_rotors(actions: FloatArray, pilot: Pilot, running: BoolArray, decision_s: float) -> None:
    share = 0.5 * (actions[running] + 1.0)
    pilot.commands[running] = share * pilot.nominal.max_rotor_thrust[running][..., None]


def _write_setpoint(
    actions: FloatArray, pilot: Pilot, running: BoolArray, decision_s: float
) -> None:
    given = actions[running]
    for k, array in enumerate(pilot.setpoint[:4]):
        array[running] = given[..., 3 * k : 3 * k + 3]
    pilot.setpoint.yaw[running] = given[..., 12]
    pilot.setpoint.yaw_rate[running] = given[..., 13]


ACTIONS: dict[str, ActionMode] = {
    mode.name: mode
    for mode in (
        ActionMode("acceleration", 3, True, SETPOINTS, _accelerator),
        ActionMode("velocity", 3, True, SETPOINTS, _velocity_keeper),
        ActionMode("ctbr", 4, True, RATES, _by_writing(_write_ctbr)),
        ActionMode("rotors", 4, True, ROTORS, _by_writing(_write_rotors)),
        ActionMode("setpoint", 14, False, SETPOINTS, _by_writing(_write_setpoint)),
    )
}
"""Every action mode by name."""


@borrowing_kernel
def all_within(actions: FloatArray, limit: float) -> bool:
    """Whether every number of (E, N, width) is finite and at most `limit` in size."""
    within = True
    for e in range(actions.shape[0]):
        for i in range(actions.shape[1]):
            for k in range(actions.shape[2]):
                within &= abs(actions[e, i, k]) <= limit
    return within


def check_actions(
    mode: ActionMode, actions: npt.ArrayLike, shape: tuple[int, int, int]
) -> FloatArray:
    """Return actions (E, N, width) as contiguous float64, refusing what the mode's Box excludes.

    Raises:
        ValueError: a wrong shape, or an entry that is not finite or outside the bounds; the
            message names the drone, the value, the rule and the fix.
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
    limit = 1.0 + _ROUNDING if mode.bounded else _LARGEST
    if all_within(array, limit):
        return array
    wrong = ~np.isfinite(array)
    rule, fix = "every number must be finite", "look for what made it so"
    if not wrong.any():
        wrong = np.abs(array) > limit
        edge = 1 if mode.bounded else f"{_LARGEST:g}"
        rule = f"must lie in [-{edge}, {edge}]"
        fix = f"clip it, as with np.clip(action, -{edge}, {edge})"
    e, i, k = (int(n) for n in np.argwhere(wrong)[0])
    where = f" in environment {e}" if shape[0] > 1 else ""
    raise ValueError(
        f"action {mode.name!r} of drone_{i}{where} has {array[e, i, k]:.8g} at index {k}, but "
        f"{rule}; {fix}"
    )
