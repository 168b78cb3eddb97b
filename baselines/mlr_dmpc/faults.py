"""What keeps drones from their targets, whatever is planned: deafness and targets taken."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.compute_unit import UnitRound
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import Drone
from swarm_envs.baselines.mlr_dmpc.trajectory import end_position
from swarm_envs.state import FloatArray

_DEAF_PLANS = 20
_SETTLED_ROUNDS = 35  # after so many rounds at rest a drone is taken to stay


class Deaf(NamedTuple):
    """A drone that seems to hear nothing."""

    drone: int
    """Which."""
    plans: int
    """How many plans in a row it has not accepted."""

    def __str__(self) -> str:
        return (
            f"drone {self.drone} has accepted none of the last {self.plans} plans for it: it seems "
            "to hear nothing"
        )


class Unreachable(NamedTuple):
    """A target that a drone cannot take."""

    drone: int
    """Whose target it is."""
    other: int
    """The drone that rests on it."""

    def __str__(self) -> str:
        return (
            f"the target of drone {self.drone} is unreachable because another drone, {self.other}, "
            "rests on it"
        )


class MissedPlans:
    """Counts, for each drone, the plans in a row that were sent to it and not accepted."""

    def __init__(self) -> None:
        self._missed: dict[int, int] = {}

    def note(self, units: Iterable[UnitRound], accepted: Collection[int]) -> None:
        """Take in a round: what units did, and which drones accepted a plan."""
        for unit in units:
            if unit.planned is not None and unit.planned.accepted:
                missed = 0 if unit.drone in accepted else self._missed.get(unit.drone, 0) + 1
                self._missed[unit.drone] = missed

    def deaf(self) -> tuple[Deaf, ...]:
        """Drones that accepted none of at least the last 20 plans, by number."""
        found = (Deaf(*one) for one in sorted(self._missed.items()))
        return tuple(one for one in found if one.plans >= _DEAF_PLANS)


def unreachable(
    drones: Sequence[Drone], targets: FloatArray, round_: int, config: MlrDmpcConfig
) -> tuple[Unreachable, ...]:
    """Targets (N, 3), m, that other drones in the air have rested on for long."""
    flying = [drone for drone in drones if drone.airborne]
    ends = {drone.index: end_position(drone.flying, config) for drone in flying}
    settled = round_ - config.horizon_rounds - _SETTLED_ROUNDS
    rest = [d.index for d in flying if d.flying.identity.start_round <= settled]
    out = []
    for drone, end in ends.items():
        if np.linalg.norm(end - targets[drone]) > config.arrival_m:
            for other in rest:
                apart = (ends[other] - targets[drone]) * config.inverse_scaling
                if other != drone and np.linalg.norm(apart) < config.sampled_distance_m:
                    out.append(Unreachable(drone, other))
    return tuple(out)
