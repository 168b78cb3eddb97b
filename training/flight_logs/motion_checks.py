"""Rules of heights and accelerations: which way is up, and in which unit."""

from __future__ import annotations

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.training.flight_logs.drone import DroneLog
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY

ACCELERATION = (0.6 * GRAVITY, 1.6 * GRAVITY)
"""Median size with gravity, m/s^2."""
WINDOW_S = 0.2
"""Accelerations are compared with those of the velocity as means over such a time."""
MOVING = 0.1
"""Spread of the velocity's acceleration above which the two are compared, m/s^2."""
OPPOSED = -0.5
"""Correlation of the two below which one of them has the wrong sign."""
_NEAR = 1.25
"""Factor within which an acceleration looks like one in some other unit."""


def check_height(drone: DroneLog) -> None:
    """Refuse heights below the ground.

    Raises:
        ValueError: the drone is usually below z = 0 while its motors run.
    """
    flown = drone.pwm.mean(axis=1) > 0.0
    height = float(np.median(drone.position[flown, 2])) if flown.any() else 0.0
    if height < 0.0:
        raise ValueError(
            f"z of drone {drone.name!r} is usually {height:.4g} m, but must be a height over the "
            "ground: z must point up; turn the sign of z and vz round, or shift z so that the "
            "ground is at 0"
        )


def check_acceleration(drone: DroneLog) -> None:
    """Refuse logged accelerations that are no m/s^2 with gravity, z up, or oppose the velocity.

    Raises:
        ValueError: their usual size or direction is wrong, or they have the opposite sign of the
            velocity's derivative along some axis.
    """
    if drone.acceleration is None:
        return
    size = float(np.median(np.linalg.norm(drone.acceleration, axis=1)))
    upwards = float(np.median(drone.acceleration[:, 2]))
    if not ACCELERATION[0] <= size <= ACCELERATION[1] or upwards < 0.0:
        raise ValueError(
            f"acceleration of drone {drone.name!r} is usually {size:.3g} m/s^2, az {upwards:+.3g}, "
            f"but must be about {GRAVITY:.2f} upwards, gravity included; "
            f"{_fix(size, upwards, drone.vehicle.mass)}"
        )
    for axis, name in enumerate("xyz"):
        logged, derived = _means(drone, drone.acceleration[:, axis], axis)
        if len(derived) < 2 or derived.std() < MOVING or logged.std() == 0.0:
            continue
        correlation = float(np.corrcoef(logged, derived)[0, 1])
        if correlation < OPPOSED:
            gravity = f" - {GRAVITY:.2f}" if name == "z" else ""
            fix = "z must point up in all columns: turn the sign of z and vz round"
            raise ValueError(
                f"a{name}{gravity} of drone {drone.name!r} opposes the change of v{name} "
                f"(correlation {correlation:.2f}), but must follow it; "
                f"{fix if gravity else f'give a{name} and v{name} in the same world frame'}"
            )


def _means(drone: DroneLog, logged: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Mean acceleration over windows without a gap: as logged, and by the velocity."""
    width = max(round(WINDOW_S / drone.step_s), 1)
    span = drone.time[width:] - drone.time[:-width]
    whole = span < 1.5 * width * drone.step_s
    step = np.diff(drone.time)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (logged[1:] + logged[:-1]) * step)])
    velocity = drone.velocity[:, axis]
    return (
        ((area[width:] - area[:-width]) / span)[whole],
        ((velocity[width:] - velocity[:-width]) / span)[whole],
    )


def _fix(size: float, upwards: float, mass: float) -> str:
    """What to do about accelerations of a wrong usual size or direction."""
    weight = mass * GRAVITY
    units = (
        (1.0, f"multiples of g: multiply by {GRAVITY}"),
        (1000.0, f"thousandths of g: multiply by {GRAVITY / 1000}"),
        (weight, f"a force in newtons: divide by the mass, {mass:g} kg"),
        (weight / GRAM_FORCE, f"a force in gram-force: multiply by {GRAM_FORCE / mass:.6g}"),
    )
    off = [abs(np.log(max(size, 1e-12) / usual)) for usual, _ in units]
    nearest = int(np.argmin(off))
    if abs(upwards) > 0.5 * size and off[nearest] < np.log(_NEAR):
        return f"it looks like {units[nearest][1]}"
    if size < ACCELERATION[0] and abs(upwards) < 0.1 * GRAVITY:
        return f"gravity seems to be missing: add {GRAVITY} to az"
    if ACCELERATION[0] <= size <= ACCELERATION[1]:
        return "the sign is turned round: in hover an accelerometer measures +g upwards"
    return "give m/s^2 in the world frame, z up"
