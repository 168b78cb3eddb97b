"""The physical vehicles that fly: their names, and how they differ from their type.

Every team is put together from one fleet: the second small drone of any team is vehicle `S2`, in
every flight the same. So what is wrong with it can be found from all its flights, as for real ones.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import VEHICLES, Team

_PER_TYPE = 100
_LARGEST_ERROR = 0.2


class Vehicles(NamedTuple):
    """What the drones of E flights of N really are."""

    mass_factor: FloatArray
    """(E, N) mass over that of the type."""
    thrust_factor: FloatArray
    """(E, N) thrust of a rotor over what was commanded."""


@typed
@dataclass(frozen=True)
class CalibrationErrors:
    """By how much vehicles differ from their type: relative standard deviations.

    The label takes mass and thrust of the type, so each vehicle gets a constant force in its
    labels, which `swarm-envs fit --offsets estimated` finds and takes out. Real flights show one or
    two grams, that is 3 to 6 % on a small drone.
    """

    mass: float = 0.0
    """of a vehicle's mass, the same in all its flights"""
    thrust: float = 0.0
    """of a vehicle's thrust, the same in all its flights"""
    thrust_per_flight: float = 0.0
    """of a vehicle's thrust, drawn anew for every flight, as batteries and propellers change"""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ValueError: a deviation is negative, or so large that drones would fall.
        """
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value <= _LARGEST_ERROR:
                raise ValueError(
                    f"{entry.name} is {value}, but must be from 0 to {_LARGEST_ERROR}: a share, so "
                    "0.03 is 3 %"
                )

    def draw(self, team: Team, seed: int, rngs: list[np.random.Generator]) -> Vehicles:
        """Draw what the drones of E flights really are.

        Args:
            team: the N vehicles.
            seed: of the fleet: decides what belongs to a vehicle in all its flights.
            rngs: E generators, one per flight.
        """
        own = np.array(
            [np.random.default_rng([seed, v]).standard_normal(2) for v in vehicle_ids(team)]
        )
        mass = np.repeat(1.0 + self.mass * own[None, :, 0], len(rngs), axis=0)
        thrust = np.repeat(1.0 + self.thrust * own[None, :, 1], len(rngs), axis=0)
        if self.thrust_per_flight:
            drift = np.stack([rng.standard_normal(len(team)) for rng in rngs])
            thrust = thrust + self.thrust_per_flight * drift
        return Vehicles(mass, thrust)


def vehicle_names(team: Team) -> tuple[str, ...]:
    """Names of the physical vehicles of a team, such as `S1`, `S2`, `L1` of `SSL`."""
    seen = Counter[str]()
    names = []
    for vehicle in team:
        seen[vehicle.token] += 1
        names.append(f"{vehicle.token}{seen[vehicle.token]}")
    return tuple(names)


def vehicle_ids(team: Team) -> tuple[int, ...]:
    """Number of each vehicle of a team in the whole fleet: 1, 2, 101 of `SSL`."""
    tokens = list(VEHICLES)
    return tuple(
        _PER_TYPE * tokens.index(vehicle.token) + int(name.removeprefix(vehicle.token))
        for vehicle, name in zip(team, vehicle_names(team), strict=True)
    )
