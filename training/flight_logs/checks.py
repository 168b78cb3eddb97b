"""The drones of a flight's table, and the checks of its consistency."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.errors import unknown_name
from swarm_envs.motors import FULL_VOLTAGE, rotor_force_g
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.training.collection.log import thrust_direction
from swarm_envs.training.flight_logs.flight_table import GROUPS, FlightTable
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES, Vehicle

PWM_SPAN = 65536.0
"""Divisor of PWM that gives motor signals (Neural-Swarm2, Sec. VII-A)."""
RUNNING = 0.2  # Mean signal above which motors run; the thrust curve is not valid below
SHORTEST_S = 1.0  # Least duration of the log of a drone, s
STEP_S = (1 / 2000, 1 / 20)  # Allowed range of the median time between two lines of a drone, s
LEAST_LOGGED = 0.1  # Least fraction of the time from a drone's first to its last line with lines
UNIT_TOLERANCE = 0.01  # Largest difference of the length of a quaternion from 1
THRUST_SHARE = (0.6, 1.6)  # Allowed range of the median thrust over the weight
PACE = (0.7, 1.4)  # Allowed range of the displacement over the integral of the velocity
HOVER = (0.6 * GRAVITY, 1.6 * GRAVITY)  # Allowed range of the median vertical acceleration, m/s^2
WINDOW_S = 0.2  # Averaging time of the comparison of accelerations with velocities, s
MOVING = 0.1  # Least standard deviation of accelerations for that comparison, m/s^2
OPPOSED = -0.5  # Correlation of accelerations below which they are in different frames


class DroneLog(NamedTuple):
    """The T lines of one drone, sorted by time; units as in `FlightTable`."""

    name: str  # Name of the physical vehicle
    vehicle: Vehicle  # Vehicle type
    line: IntArray  # (T,) line numbers in the file
    time: FloatArray  # (T,) s
    position: FloatArray  # (T, 3) m, world frame
    velocity: FloatArray  # (T, 3) m/s, world frame
    quaternion: FloatArray  # (T, 4) x, y, z, w, body to world
    acceleration: FloatArray | None
    """(T, 3) m/s^2, world frame, with gravity; None if it was not logged."""
    pwm: FloatArray  # (T, 4) motor signals
    voltage: FloatArray  # (T,) battery voltage, V

    @property
    def step_s(self) -> float:
        """The median time between two lines, s."""
        return float(np.median(np.diff(self.time)))

    def thrust_g(self) -> FloatArray:
        """Return the thrust (T,) of the logged signals by the thrust curve (psi1), gram-force."""
        volts = self.voltage[:, None] / FULL_VOLTAGE
        force = rotor_force_g(self.vehicle, self.pwm / PWM_SPAN, volts)
        return np.asarray(force).sum(axis=-1)


def checked_drones(table: FlightTable) -> tuple[DroneLog, ...]:
    """Return the drones of a flight sorted by name, with their lines sorted by time.

    Quaternions are normalized. Lines of the table may be in any order.

    Raises:
        ValueError: a check fails; the message names the drone, the value and the rule.
    """
    drones = tuple(_drone(table, str(name)) for name in np.unique(table.drone))
    for drone in drones:
        for check in _CHECKS:
            check(drone)
    return tuple(
        d._replace(quaternion=d.quaternion / np.linalg.norm(d.quaternion, axis=1, keepdims=True))
        for d in drones
    )


def _drone(table: FlightTable, name: str) -> DroneLog:
    own = np.flatnonzero(table.drone == name)
    own = own[np.argsort(table.time[own], kind="stable")]
    types = np.unique(table.type[own]).tolist()
    if len(types) > 1:
        raise ValueError(f"drone {name!r} has the types {', '.join(types)}, but must have one")
    if types[0] not in VEHICLES:
        raise ValueError(unknown_name("vehicle type", types[0], VEHICLES, f"of drone {name!r}"))
    values = {
        group: None if getattr(table, group) is None else getattr(table, group)[own]
        for group in GROUPS
    }
    return DroneLog(name=name, vehicle=VEHICLES[types[0]], line=table.line[own], **values)  # type: ignore[arg-type]


def _check_time(drone: DroneLog) -> None:
    step = np.diff(drone.time)
    if not len(step) or drone.time[-1] - drone.time[0] < SHORTEST_S:
        raise ValueError(
            f"drone {drone.name!r} has {len(drone.time)} lines, but must have at least "
            f"{SHORTEST_S:g} s of them; remove the drone if it did not fly"
        )
    if (step <= 0.0).any():
        k = int(np.argmax(step <= 0.0))
        raise ValueError(
            f"line {drone.line[k + 1]}: drone {drone.name!r} has time {drone.time[k]:g} s in line "
            f"{drone.line[k]} too, but must have one line at a time; remove duplicates"
        )
    if not STEP_S[0] <= drone.step_s <= STEP_S[1]:
        raise ValueError(
            f"lines of drone {drone.name!r} are usually {drone.step_s:g} s apart, but must be "
            f"{STEP_S[0]:g} to {STEP_S[1]:g} s: 20 to 2000 lines per second"
        )
    if len(step) * drone.step_s < LEAST_LOGGED * (drone.time[-1] - drone.time[0]):
        k = int(np.argmax(step))
        raise ValueError(
            f"line {drone.line[k + 1]}: the time of drone {drone.name!r} jumps by {step[k]:g} s, "
            "so that less than a tenth of the time is logged; write one file per flight"
        )


def _check_attitude(drone: DroneLog) -> None:
    length = np.linalg.norm(drone.quaternion, axis=1)
    off = np.abs(length - 1.0) > UNIT_TOLERANCE
    if off.any():
        k = int(np.argmax(off))
        raise ValueError(
            f"line {drone.line[k]}: the quaternion of drone {drone.name!r} has length "
            f"{length[k]:.4g}, but must have length 1 (within {UNIT_TOLERANCE})"
        )
    upright = float(np.median(thrust_direction(drone.quaternion)[:, 2]))
    if upright < 0.5:
        raise ValueError(
            f"the thrust direction of drone {drone.name!r} usually has the vertical component "
            f"{upright:+.2f}, but must exceed 0.5; the quaternion is qx, qy, qz, qw, body to "
            "world, z up"
        )


def _check_motion(drone: DroneLog) -> None:
    """Raise ValueError if displacements do not match the velocity."""
    step = np.diff(drone.time)[:, None]
    mean = 0.5 * (drone.velocity[1:] + drone.velocity[:-1])
    near = step[:, 0] < 3.0 * drone.step_s
    moved, expected = np.diff(drone.position, axis=0)[near], (mean * step)[near]
    speed = float(np.sqrt(np.mean(np.sum(mean**2, axis=1))))
    if speed > 0.05:
        pace = float((moved * expected).sum() / (expected * expected).sum())
        if not PACE[0] <= pace <= PACE[1]:
            raise ValueError(
                f"the displacement of drone {drone.name!r} is {pace:.3g} times the integral of its "
                f"velocity, but must be {PACE[0]} to {PACE[1]} times; both are in SI units, world "
                "frame"
            )


def _check_acceleration(drone: DroneLog) -> None:
    """Raise ValueError if accelerations lack gravity, or another axis is up."""
    if drone.acceleration is None:
        return
    upwards = float(np.median(drone.acceleration[:, 2]))
    if not HOVER[0] <= upwards <= HOVER[1]:
        raise ValueError(
            f"az of drone {drone.name!r} is usually {upwards:+.3g} m/s^2, but must be about "
            f"{GRAVITY:+.2f}, gravity included, in the world frame with z up"
        )


def _check_frame(drone: DroneLog) -> None:
    """Raise ValueError if accelerations oppose the change of the velocity."""
    if drone.acceleration is None:
        return
    width = max(round(WINDOW_S / drone.step_s), 1)
    step, span = np.diff(drone.time)[:, None], drone.time[width:] - drone.time[:-width]
    gained = np.cumsum(0.5 * (drone.acceleration[1:] + drone.acceleration[:-1]) * step, axis=0)
    gained = np.concatenate([np.zeros((1, 3)), gained])
    whole = span < 1.5 * width * drone.step_s
    logged, derived = (
        ((values[width:] - values[:-width]) / span[:, None])[whole]
        for values in (gained, drone.velocity)
    )
    for axis, name in enumerate("xyz"):
        one, other = logged[:, axis], derived[:, axis]
        if len(other) < 2 or other.std() < MOVING or one.std() == 0.0:
            continue
        correlation = float(np.corrcoef(one, other)[0, 1])
        if correlation < OPPOSED:
            raise ValueError(
                f"a{name} of drone {drone.name!r} opposes the change of v{name} (correlation "
                f"{correlation:.2f}), but must follow it; both are in the world frame, z up"
            )


def _check_carried(drone: DroneLog) -> None:
    """Raise ValueError if the thrust of the motor signals does not match the weight."""
    signal = drone.pwm.mean(axis=1)
    running = signal > RUNNING * PWM_SPAN
    if not running.any():
        raise ValueError(
            f"motors of drone {drone.name!r} never run (mean PWM at most {signal.max():g}, but "
            f"must exceed {RUNNING * PWM_SPAN:g}); remove the drone if it did not fly"
        )
    thrust = float(np.median(drone.thrust_g()[running]))
    acceleration = GRAVITY
    if drone.acceleration is not None:
        acceleration = float(np.median(np.linalg.norm(drone.acceleration[running], axis=1)))
    carried = drone.vehicle.mass * acceleration / GRAM_FORCE
    if not THRUST_SHARE[0] <= thrust / carried <= THRUST_SHARE[1]:
        raise ValueError(
            f"the thrust of drone {drone.name!r} is usually {thrust:.1f} g by its thrust curve, "
            f"but its type {drone.vehicle.token!r} needs {carried:.1f} g; the ratio must be within "
            f"{THRUST_SHARE[0]} to {THRUST_SHARE[1]}: check the type, the PWM and the voltage"
        )


_CHECKS = (
    _check_time,
    _check_attitude,
    _check_motion,
    _check_acceleration,
    _check_frame,
    _check_carried,
)
"""The checks in order."""
