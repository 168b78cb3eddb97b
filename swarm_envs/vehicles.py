"""The vehicles of the papers, with the source of every number.

`SMALL` and `LARGE` are the quadrotors of Neural-Swarm2, Table I; `SMALL_STRONG` (token `S*`) is the
small one with stronger motors of its ring flights (Fig. 9).

Rotors form an X and are numbered as on the Crazyflie, seen from above with x forward and y left:
1 front right, 2 back right, 3 back left, 4 front left. Rotors 1 and 3 turn counterclockwise.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from swarm_envs.errors import check_number, check_numbers, check_type, unknown_name

__all__ = [
    "GRAM_FORCE",
    "GRAVITY",
    "LARGE",
    "SMALL",
    "VEHICLES",
    "Team",
    "Vehicle",
    "parse_team",
    "team_string",
]

GRAVITY = 9.80665
"""Standard gravity, m/s^2. World z points up, so gravity is (0, 0, -GRAVITY)."""

GRAM_FORCE = GRAVITY * 1e-3
"""One gram-force in newton: the papers give forces in grams."""


@dataclass(frozen=True)
class Vehicle:
    """A type of quadrotor. SI units; body frame x forward, y left, z up along thrust.

    Raises:
        ValueError: a quantity is not positive and finite; the message names it.
    """

    token: str
    """The token in team strings: `S`, `L`, `S*`."""
    mass: float
    """Mass m, kg."""
    inertia: tuple[float, float, float]
    """Principal moments of inertia, the diagonal of J, kg m^2."""
    max_thrust: float
    """Largest total thrust of the four rotors at a full battery, N."""
    diameter: float
    """Diameter of the collision sphere, m."""
    arm: float
    """Distance from the center to a rotor's axis, m."""
    rotor_radius: float
    """Radius of one propeller, m."""
    thrust_to_torque: float
    """Yaw torque per newton of rotor thrust, m."""
    motor_rate: float
    """Motor rate lambda of eq. (1c), 1/s, the inverse of the time constant of the thrust."""
    interaction_type: str
    """The type of the airframe in interaction models: `S` or `L`."""
    pwm_to_force: tuple[float, float, float, float, float]
    """psi1 of Table I, the force of one rotor, g: coefficients of 1, p, v, p^2, p v."""
    force_to_pwm: tuple[float, float, float, float, float]
    """psi2 of Table I, the signal for a force f, g, of one rotor: coefficients of 1, f, v, f^2,
    f v."""
    pwm_to_max_force: tuple[float, float, float]
    """psi3 of Table I, the largest force of one rotor, g: coefficients of 1, p, v."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in (
            "mass",
            "max_thrust",
            "diameter",
            "arm",
            "rotor_radius",
            "thrust_to_torque",
            "motor_rate",
        ):
            check_number(name, getattr(self, name), above=0.0)
        check_numbers("inertia", self.inertia, 3, above=0.0)
        for name, count in (("pwm_to_force", 5), ("force_to_pwm", 5), ("pwm_to_max_force", 3)):
            check_numbers(name, getattr(self, name), count)
        for name in ("token", "interaction_type"):
            check_type(name, getattr(self, name), str)

    @property
    def radius(self) -> float:
        """Radius of the collision sphere, m."""
        return self.diameter / 2

    @property
    def max_rotor_thrust(self) -> float:
        """Largest thrust of one rotor at a full battery, N."""
        return self.max_thrust / 4

    @property
    def hover_rotor_thrust(self) -> float:
        """Thrust of one rotor in hover, N: a quarter of the weight."""
        return self.mass * GRAVITY / 4

    @property
    def thrust_to_weight(self) -> float:
        """Largest thrust over weight."""
        return self.max_thrust / (self.mass * GRAVITY)


SMALL = Vehicle(
    token="S",
    mass=0.034,  # Neural-Swarm2, Table I
    inertia=(16.572e-6, 16.656e-6, 29.262e-6),  # Foerster 2015, Crazyflie 2.0
    max_thrust=65 * GRAM_FORCE,  # Table I
    diameter=0.12,  # Table I
    arm=0.046,  # Crazyflie 2.X: 92 mm between opposite rotors
    rotor_radius=0.0231,  # Crazyflie 2.X propeller
    thrust_to_torque=0.005965,  # Foerster 2015
    motor_rate=16.0,  # Table I
    interaction_type="S",
    pwm_to_force=(11.0934, -39.0810, -9.5256, 20.5733, 38.4289),  # Table I, identified digits
    force_to_pwm=(0.5, 0.12, -0.41, -0.002, -0.043),  # Table I
    pwm_to_max_force=(-9.86, 3.02, 26.72),  # Table I, sign of the last misprinted there
)
"""The small quadrotor: a Crazyflie 2.X."""


def _scaled_inertia(mass: float, diameter: float) -> tuple[float, float, float]:
    """Return the inertia of SMALL, scaled by mass and by diameter squared, kg m^2."""
    scale = mass / SMALL.mass * (diameter / SMALL.diameter) ** 2
    x, y, z = SMALL.inertia
    return (x * scale, y * scale, z * scale)


_LARGE_SCALE = 0.19 / SMALL.diameter

LARGE = Vehicle(
    token="L",
    mass=0.067,  # Table I
    inertia=_scaled_inertia(0.067, 0.19),  # not published: SMALL's, by mass and diameter squared
    max_thrust=145 * GRAM_FORCE,  # Table I
    diameter=0.19,  # Table I
    arm=SMALL.arm * _LARGE_SCALE,  # not published: SMALL's, by diameter
    rotor_radius=SMALL.rotor_radius * _LARGE_SCALE,  # not published: SMALL's, by diameter
    thrust_to_torque=SMALL.thrust_to_torque * _LARGE_SCALE,  # not published: SMALL's, by diameter
    motor_rate=16.0,  # Table I
    interaction_type="L",
    pwm_to_force=(44.1039, -122.5115, -36.1848, 53.1077, 107.6819),  # Table I, identified digits
    force_to_pwm=(0.56, 0.06, -0.6, -0.0007, -0.015),  # Table I
    pwm_to_max_force=(-29.91, 8.1, 65.2),  # Table I
)
"""The large quadrotor: a Crazyflie 2.1 board on a larger frame with brushed motors."""


def _stronger(vehicle: Vehicle, token: str, max_thrust: float) -> Vehicle:
    """Return a vehicle whose motors give proportionally more force at every signal."""
    k = max_thrust / vehicle.max_thrust
    a, b, c, d, e = vehicle.force_to_pwm
    f0, f1, f2, f3, f4 = vehicle.pwm_to_force
    m0, m1, m2 = vehicle.pwm_to_max_force
    return replace(
        vehicle,
        token=token,
        max_thrust=max_thrust,
        pwm_to_force=(k * f0, k * f1, k * f2, k * f3, k * f4),
        force_to_pwm=(a, b / k, c, d / k**2, e / k),
        pwm_to_max_force=(k * m0, k * m1, k * m2),
    )


SMALL_STRONG = _stronger(SMALL, "S*", 2.6 * SMALL.mass * GRAVITY)
"""SMALL with motors for a thrust-to-weight ratio of 2.6 (Neural-Swarm2, Sec. VII-E). Their
polynomials are not published; they are those of SMALL, with forces scaled to this ratio."""

VEHICLES: dict[str, Vehicle] = {v.token: v for v in (SMALL, LARGE, SMALL_STRONG)}
"""The shipped vehicles by token."""

_TOKEN = re.compile(r"[A-Z]\*?|.")

Team = tuple[Vehicle, ...]
"""The vehicles of a team, at least one, in the order of the agents."""


def parse_team(team: str | Sequence[Vehicle]) -> Team:
    """Return a team such as `"SSL"`, `"S*S*LL"` or `"L2S"` as a tuple of vehicles.

    The tokens are `S`, `L` and `S*`. A `2` separates the upper drones from the lowest in the
    notation of Neural-Swarm2 (`"SL2S"`: small and large above small); the lowest drone comes last.
    A sequence of vehicles is returned as a tuple.

    Raises:
        ValueError: the team is empty or has an unknown token.
    """
    if not isinstance(team, Sequence):
        raise ValueError(f"team is {team!r}, but must be a string such as 'SSL' or Vehicles")
    vehicles: Team
    if isinstance(team, str):
        vehicles = _read_tokens(team)
    else:
        vehicles = tuple(team)
        for vehicle in vehicles:
            if not isinstance(vehicle, Vehicle):
                raise ValueError(
                    f"team contains {vehicle!r}, but must be a string such as 'SSL' or a sequence "
                    "of Vehicles, such as swarm_envs.vehicles.SMALL"
                )
    if not vehicles:
        raise ValueError(f"team {team!r} has no drones; name at least one, such as 'S' or 'SSL'")
    return vehicles


def team_string(team: Sequence[Vehicle]) -> str:
    """Return the string of a team, the inverse of `parse_team`."""
    return "".join(vehicle.token for vehicle in parse_team(team))


@lru_cache(maxsize=256)
def _read_tokens(team: str) -> Team:
    tokens = [token for token in _TOKEN.findall(team) if token != "2"]
    for token in tokens:
        if token not in VEHICLES:
            problem = unknown_name("vehicle token", token, VEHICLES, f"in team {team!r}")
            raise ValueError(f"{problem}; write a letter for each drone, such as 'LLLSSS'")
    return tuple(VEHICLES[token] for token in tokens)
