"""Domain randomization."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from swarm_envs.errors import check_interval, check_name, check_number, parse_pairs
from swarm_envs.state import FloatArray
from swarm_envs.tables import World
from swarm_envs.vehicles import GRAVITY, Team

__all__ = ["Randomization"]

Factor = tuple[float, float]
"""Bounds of a factor with a uniform distribution."""
SAME: Factor = (1.0, 1.0)  # The factor 1, which changes nothing

FACTORS = {
    "mass": "mass",
    "inertia": "inertia",
    "motor_rate": "motor_rate",
    "thrust": "max_rotor_thrust",
}
"""Options that scale a field of the drones' records, and the name of that field."""

_LEAST_THRUST_TO_WEIGHT = 1.1


@dataclass(frozen=True)
class Randomization:
    """Domain randomization, sampled at every reset from the environment's generator.

    Factors are uniform between two numbers and multiply the nominal value of each drone; the
    controller uses the nominal value. Noise is white and Gaussian, specified by its standard
    deviation per component, and affects observations only: the tracking controller receives the
    true state. With `world="hall"`, observations and controller use a state estimate instead.

    docs/tasks.md ("Randomization and noise") has a table of the fields with their units.

    Raises:
        ValueError: a range is empty or not positive, or a standard deviation is negative.
    """

    mass: Factor = SAME
    """Factor of the mass."""
    inertia: Factor = SAME
    """Factor of the moments of inertia, the same for all three axes."""
    motor_rate: Factor = SAME
    """Factor of the motor rate lambda, the inverse of the time constant."""
    thrust: Factor = SAME
    """Factor of the largest rotor thrust."""
    force_scale: Factor = SAME
    """Factor of the interaction force, its drag included; one per environment."""
    hall: Factor = SAME
    """Factor of the random force, force offsets and thrust errors of `world="hall"`; one per
    environment."""
    battery: tuple[float, float] = SAME
    """Range of each drone's charge at the start; needs `battery=BatteryModel()`."""
    gust_acceleration: float = 0.0
    """Standard deviation of each component of the acceleration by gusts, m/s^2, the same for all
    drones of an environment."""
    gust_time_s: float = 1.0
    """Correlation time of gusts, s."""
    position_noise_m: float = 0.0
    """Noise of observed positions, m."""
    velocity_noise: float = 0.0
    """Noise of observed velocities, m/s."""
    attitude_noise_rad: float = 0.0
    """Noise of observed attitudes, rad."""
    body_rate_noise: float = 0.0
    """Noise of observed body rates, rad/s."""
    noise_scale: tuple[float, float] = SAME
    """Factor of all noise; one per environment."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and for a factor of noise without noise."""
        for name in ("mass", "inertia", "motor_rate", "thrust", "force_scale", "hall"):
            check_interval(name, getattr(self, name), above=0.0)
        check_interval("battery", self.battery, above=0.0, at_most=1.0)
        for name in (
            "gust_acceleration",
            "position_noise_m",
            "velocity_noise",
            "attitude_noise_rad",
            "body_rate_noise",
        ):
            check_number(name, getattr(self, name), at_least=0.0)
        check_number("gust_time_s", self.gust_time_s, above=0.0, unit="s")
        check_interval("noise_scale", self.noise_scale, at_least=0.0)
        if self.noise_scale != SAME and not self.noisy:
            raise ValueError(
                f"noise_scale is {self.noise_scale}, but there is no noise to scale; give a "
                "standard deviation too, such as position_noise_m=0.02"
            )

    @classmethod
    def of(cls, given: Randomization | str | None) -> Randomization | None:
        """Return the randomization for an option such as `mass=0.9:1.1,thrust=1:1.2`.

        Raises:
            ValueError: the text has an unknown field or an invalid value.
        """
        if not isinstance(given, str):
            return given
        values: dict[str, Any] = {}
        for name, numbers in parse_pairs("randomization", given, "mass=0.9:1.1,thrust=1:1.2"):
            check_name("randomization", name, [field.name for field in fields(cls)])
            ranged = isinstance(getattr(cls, name), tuple)
            if len(numbers) != (2 if ranged else 1):
                got = ":".join(f"{number:g}" for number in numbers)
                rule = f"a range, {name}=LOW:HIGH" if ranged else f"one number, {name}=NUMBER"
                raise ValueError(f"randomization is {name}={got}, but must be {rule}")
            values[name] = numbers[0] if len(numbers) == 1 else tuple(numbers)
        return cls(**values)

    def check_team(self, team: Team) -> None:
        """Raise ValueError if a vehicle might be unable to hover."""
        for vehicle in team:
            most = self.thrust[0] * vehicle.max_thrust
            weight = self.mass[1] * vehicle.mass * GRAVITY
            if most < _LEAST_THRUST_TO_WEIGHT * weight:
                raise ValueError(
                    f"Randomization(mass={self.mass}, thrust={self.thrust}) can leave "
                    f"{vehicle.token!r} with a thrust-to-weight ratio of {most / weight:.2f}, but "
                    f"it needs {_LEAST_THRUST_TO_WEIGHT} to fly; narrow the ranges"
                )

    @property
    def noisy(self) -> bool:
        """True if observations are noisy."""
        return any(self.noise)

    @property
    def noise(self) -> tuple[float, float, float, float]:
        """Standard deviations of position, velocity, attitude and body rate."""
        return (
            float(self.position_noise_m),
            float(self.velocity_noise),
            float(self.attitude_noise_rad),
            float(self.body_rate_noise),
        )


def draw_vehicles(rng: np.random.Generator, ranges: Randomization, e: int, world: World) -> None:
    """Sample the parameters, charges and noise keys of a new episode of environment `e`.

    Args:
        rng: the environment's generator.
        ranges: the distributions.
        e: index of the environment.
        world: the tables, of which those of `e` are written.
    """
    drones, environments = world.drones, world.environments
    for option, field in FACTORS.items():
        low, high = getattr(ranges, option)
        usual: FloatArray = drones[f"nominal_{field}"][e]
        factor = rng.uniform(low, high, len(usual))
        drones[field][e] = usual * (factor if usual.ndim == 1 else factor[:, None])
    environments["force_scale"][e] = rng.uniform(*ranges.force_scale)
    drones["charge"][e] = rng.uniform(*ranges.battery, drones.shape[1])
    gust_key, noise_key = rng.integers(2**63, size=2)
    environments["gust_key"][e], environments["noise_key"][e] = gust_key, noise_key
    if ranges.noise_scale != SAME:
        environments["noise_scale"][e] = rng.uniform(*ranges.noise_scale)


def scale_hall(
    rng: np.random.Generator, ranges: Randomization | None, e: int, world: World
) -> None:
    """Multiply the hall's random forces and errors in environment `e` by the factor `hall`."""
    if ranges is None or ranges.hall == SAME:
        return
    factor, drones = rng.uniform(*ranges.hall), world.drones[e]
    for name in ("residual_quiet", "residual_more", "residual_alone", "force_offset"):
        drones[name] *= factor
    drones["thrust_gain"] = 1.0 + factor * (drones["thrust_gain"] - 1.0)
