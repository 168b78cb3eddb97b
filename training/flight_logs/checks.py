"""The drones of a flight's table, and its rules: what is refused, and how to mend it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.errors import unknown_name
from swarm_envs.motors import FULL_VOLTAGE, rotor_force_g
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.log import thrust_direction
from swarm_envs.training.collection.storage import PWM_SPAN
from swarm_envs.training.flight_table import GROUPS, FlightTable
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES, Vehicle


class DroneLog(NamedTuple):
    """Lines of one drone, T of them, in order of time; units as in `FlightTable`."""

    name: str  # Of the physical vehicle
    vehicle: Vehicle  # Its type
    time: FloatArray  # (T,) s
    position: FloatArray  # (T, 3) m, world frame
    velocity: FloatArray  # (T, 3) m/s, world frame
    quaternion: FloatArray  # (T, 4) x, y, z, w, body to world
    acceleration: FloatArray | None
    """(T, 3) m/s^2, world frame, with gravity; None if it was not logged."""
    pwm: FloatArray  # (T, 4) signals of the motors
    voltage: FloatArray  # (T,) of the battery, V

    @property
    def step_s(self) -> float:
        """Usual time between two lines, s."""
        return float(np.median(np.diff(self.time)))

    def thrust_g(self) -> FloatArray:
        """Thrust (T,) that psi1 gives at the logged signals, gram-force."""
        volts = self.voltage[:, None] / FULL_VOLTAGE
        force = rotor_force_g(self.vehicle, self.pwm / PWM_SPAN, volts)
        return np.asarray(force).sum(axis=-1)


ACCELERATION = (0.6 * GRAVITY, 1.6 * GRAVITY)  # Median size with gravity, m/s^2
WINDOW_S = 0.2  # Accelerations are compared with those of the velocity as means over such a time
MOVING = 0.1  # Spread of the velocity's acceleration above which the two are compared, m/s^2
OPPOSED = -0.5  # Correlation of the two below which one of them has the wrong sign
_NEAR = 1.25  # Factor within which an acceleration looks like one in some other unit


def check_height(drone: DroneLog) -> None:
    """Refuse heights below the ground."""
    flown = drone.pwm.mean(axis=1) > 0.0
    height = float(np.median(drone.position[flown, 2])) if flown.any() else 0.0
    if height < 0.0:
        raise ValueError(
            f"z of drone {drone.name!r} is usually {height:.4g} m, but must be a height over the "
            "ground: z must point up; turn the sign of z and vz round, or shift z so that the "
            "ground is at 0"
        )


def check_acceleration(drone: DroneLog) -> None:
    """Refuse logged accelerations that are no m/s^2 with gravity, z up, or oppose the velocity."""
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


RUNNING = 0.2  # Mean signal above which motors run: psi1 has no meaning below
SHORTEST_S = 1.0  # Logs of a drone shorter than this are refused, s
STEP_S = (1 / 2000, 1 / 20)  # Usual time between two lines of a drone, shortest and longest
UNIT_TOLERANCE = 0.01  # By how much the length of a quaternion may differ from 1
VOLTAGE_V = (2.5, 4.5)  # Lowest and highest voltage that is accepted, V
THRUST_SHARE = (0.6, 1.6)  # Median thrust by psi1 over what the drone carried
PACE = (0.7, 1.4)  # Movement of the position over that by the velocity


def checked_drones(table: FlightTable) -> tuple[DroneLog, ...]:
    """Return the drones of a flight, sorted by name, attitudes of exactly unit length."""
    _check_finite(table)
    names = np.unique(table.drone)
    if "" in names:
        raise ValueError("column 'drone' is empty in some line; name the vehicle in every line")
    drones = tuple(_drone(table, str(name)) for name in names)
    for drone in drones:
        for check in _CHECKS:
            check(drone)
    return tuple(
        d._replace(quaternion=d.quaternion / np.linalg.norm(d.quaternion, axis=1, keepdims=True))
        for d in drones
    )


def _check_finite(table: FlightTable) -> None:
    for group, names in GROUPS.items():
        values = getattr(table, group)
        if values is None or np.isfinite(values).all():
            continue
        values = values.reshape(len(table), len(names))
        row, column = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise ValueError(
            f"column {names[column]!r} is {values[row, column]} in line {row + 2} (drone "
            f"{str(table.drone[row])!r}), but must be finite; remove lines that hold no measurement"
        )


def _drone(table: FlightTable, name: str) -> DroneLog:
    own = table.drone == name
    types = np.unique(table.type[own]).tolist()
    if len(types) > 1:
        raise ValueError(
            f"drone {name!r} has the types {', '.join(types)}, but must have one; give one"
        )
    if types[0] not in VEHICLES:
        raise ValueError(unknown_name("vehicle type", types[0], VEHICLES, f"of drone {name!r}"))
    values = {
        group: None if getattr(table, group) is None else getattr(table, group)[own]
        for group in GROUPS
    }
    return DroneLog(name=name, vehicle=VEHICLES[types[0]], **values)  # type: ignore[arg-type]


def _check_time(drone: DroneLog) -> None:
    step = np.diff(drone.time)
    if (step <= 0.0).any():
        k = int(np.argmax(step <= 0.0))
        raise ValueError(
            f"time of drone {drone.name!r} goes from {drone.time[k]} to {drone.time[k + 1]} s at "
            f"its line {k + 2}, but must increase; sort its lines by time and remove doubles"
        )
    if len(step) and not STEP_S[0] <= drone.step_s <= STEP_S[1]:
        raise ValueError(
            f"lines of drone {drone.name!r} are usually {drone.step_s:g} apart, but must be "
            f"{STEP_S[0]:g} to {STEP_S[1]:g} s; give the time in seconds, 20 to 2000 lines a second"
        )
    if not len(step) or drone.time[-1] - drone.time[0] < SHORTEST_S:
        raise ValueError(
            f"drone {drone.name!r} has {len(drone.time)} lines, but must have at least "
            f"{SHORTEST_S:g} s of them; remove the drone if it did not fly"
        )


def _check_motors(drone: DroneLog) -> None:
    least, most = float(drone.pwm.min()), float(drone.pwm.max())
    if least < 0.0 or most >= PWM_SPAN or 0.0 < most <= 255.0:
        scale = next((f" (it looks like {s}: multiply by {65535 / m:.6g})" for s, m in
                      (("0 to 1", 1.0), ("per cent", 100.0), ("0 to 255", 255.0))
                      if least >= 0.0 and most <= m), "")  # fmt: skip
        scale = _thrust_hint(drone) or scale
        raise ValueError(
            f"PWM of drone {drone.name!r} goes from {least:g} to {most:g}, but must be the signal "
            f"from 0 to 65535{scale}"
        )
    low, high = VOLTAGE_V
    if drone.voltage.min() < low or drone.voltage.max() > high:
        worst = drone.voltage[np.argmax(np.abs(drone.voltage - 0.5 * (low + high)))]
        fix = "give the voltage of one cell under load"
        if np.median(drone.voltage) > 1000.0:
            fix = "it looks like millivolts: divide by 1000"
        elif np.median(drone.voltage) <= 1.2:
            fix = "it looks divided by 4.2 V: multiply by it"
        raise ValueError(
            f"voltage of drone {drone.name!r} is {worst:g}, but must be {low} to {high} V; {fix}"
        )


def _thrust_hint(drone: DroneLog) -> str:
    """What to say if the signals are the rotors' forces: their sum carries the vehicle."""
    total = float(np.median(drone.pwm.sum(axis=1)))
    for unit, newton in (("gram-force", GRAM_FORCE), ("newtons", 1.0)):
        if THRUST_SHARE[0] <= total * newton / (drone.vehicle.mass * GRAVITY) <= THRUST_SHARE[1]:
            return f" (it looks like thrust in {unit}: log the signal that the motors are given)"
    return ""


def _check_attitude(drone: DroneLog) -> None:
    length = np.linalg.norm(drone.quaternion, axis=1)
    off = np.abs(length - 1.0) > UNIT_TOLERANCE
    if off.any():
        k = int(np.argmax(off))
        degrees = " (it looks like degrees)" if np.abs(drone.quaternion).max() > 2.0 else ""
        raise ValueError(
            f"attitude quaternion of drone {drone.name!r} has length {length[k]:.4g} at its line "
            f"{k + 1}, but must have 1 (within {UNIT_TOLERANCE}); give (qx, qy, qz, qw) unscaled, "
            f"no angles{degrees}"
        )
    upright = float(np.median(thrust_direction(drone.quaternion)[:, 2]))
    if upright < 0.5:
        raise ValueError(
            f"drone {drone.name!r} usually points its thrust {upright:+.2f} upwards, but must more "
            "than 0.5; give the quaternion as qx, qy, qz, qw with qw the scalar, body to world, "
            "z up"
        )


def _check_motion(drone: DroneLog) -> None:
    step = np.diff(drone.time)[:, None]
    mean = 0.5 * (drone.velocity[1:] + drone.velocity[:-1])
    near = step[:, 0] < 3.0 * drone.step_s
    moved, expected = np.diff(drone.position, axis=0)[near], (mean * step)[near]
    speed = float(np.sqrt(np.mean(np.sum(mean**2, axis=1))))
    if speed > 0.05:
        pace = float((moved * expected).sum() / (expected * expected).sum())
        if not PACE[0] <= pace <= PACE[1]:
            raise ValueError(
                f"position of drone {drone.name!r} moves {pace:.3g} times as its velocity says, "
                f"but must {PACE[0]} to {PACE[1]} times; give m and m/s, both in the world frame"
            )


def _check_carried(drone: DroneLog) -> None:
    running = drone.pwm.mean(axis=1) > RUNNING * PWM_SPAN
    if not running.any():
        raise ValueError(
            f"motors of drone {drone.name!r} never run (mean PWM at most "
            f"{drone.pwm.mean(axis=1).max():g}); remove the drone if it did not fly"
        )
    thrust = float(np.median(drone.thrust_g()[running]))
    acceleration = GRAVITY
    if drone.acceleration is not None:
        acceleration = float(np.median(np.linalg.norm(drone.acceleration[running], axis=1)))
    carried = drone.vehicle.mass * acceleration / GRAM_FORCE
    if not THRUST_SHARE[0] <= thrust / carried <= THRUST_SHARE[1]:
        raise ValueError(
            f"motors of drone {drone.name!r} usually give {thrust:.1f} g by its thrust curve, but "
            f"its type {drone.vehicle.token!r} carries {carried:.1f} g; the two must agree within "
            f"{THRUST_SHARE[0]} to {THRUST_SHARE[1]}: check the type, the PWM and the voltage"
        )


_CHECKS = (_check_time, _check_motors, _check_attitude, check_height, _check_motion,
           check_acceleration, _check_carried)  # fmt: skip
