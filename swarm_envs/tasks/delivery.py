"""Delivery: couriers dock just above the floor, below hovering drones, and move on.

Three docks lie on a circle. Above some of them, sampled for each episode, two drones hover: their
downwash pushes a courier toward the near floor with up to two thirds of its weight. Three couriers
visit the docks in turn, another one in each stage, so that a constant correction does not help. The
goals of the hovering drones are their starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_integer, check_interval, check_number, check_type
from swarm_envs.tasks.base import Given, Placement, Success, Task
from swarm_envs.tasks.columns import DOWNWASH_DEFAULTS, RAMP
from swarm_envs.tasks.learning import in_time
from swarm_envs.tasks.motion import LINES, Motion
from swarm_envs.vehicles import Team, parse_team

__all__ = ["DeliveryTask"]

DOCKS = 3  # Number of docks, and of couriers
_SECOND_M = 0.35  # Height of the second drone above a dock over the first, m
_OUTSIDE, _START_HEIGHT_M = 1.4, 0.5
"""Starts of couriers: distance from the center over that of the docks, and height, m."""


def delivery_team(num_drones: int) -> Team:
    """Return three couriers `S*`, then `L` that hover above docks."""
    check_integer("num_drones", num_drones, at_least=1)
    return parse_team("S*" * min(num_drones, DOCKS) + "L" * (num_drones - DOCKS))


@dataclass(frozen=True)
class DeliveryTask(Task):
    """Delivery, version 0: drones dock just above the floor, below hovering drones, and move on.

        from swarm_envs import delivery_v0
        env = delivery_v0.parallel_env()

    Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. By default drones fly in
    the world `"hall"`, and each observes seven neighbors and, with `observe_load`, the thrust
    margin, mass and charge of itself and of its neighbors.

    **Team.** Three couriers, which are strong small drones; then large drones that hover above
    docks, two above each. By default there are four, above two of three docks.

    **Start.** Three docks are 0.8 m from the center; docked couriers are 0.093 to 0.103 m high, and
    touch the floor at 0.06 m. The first large drone hovers 0.28 to 0.36 m above, the second 0.35 m
    higher. Rotation, heights, the docks below large drones, and the first dock of each courier are
    random. Couriers start outside their first dock, 0.5 m high; after each stage they move to the
    next, all in the same direction. `reset(options={"start": ...})` sets other starts. Goals cannot
    be set.

    **Success.** A stage of 2.2 s is reached if every drone was within 0.02 m of its goal for 0.4 s.
    Success: all three stages were reached, without a collision.

    **Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is one over the
    number of stages, for each stage reached.

    **End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision,
    the floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes
    are terminated by success and truncated after 6.6 s.

    **Versions.** v0: first version.
    """

    radius_m: float = 0.8
    """Radius of the circle of docks, m."""
    height_m: tuple[float, float] = (0.093, 0.103)
    """Range of the height of docked couriers, m; a small drone touches the floor at 0.06 m."""
    above_m: tuple[float, float] = (0.28, 0.36)
    """Range of the height of the lower hovering drone over the docked courier, m."""
    stages: int = 3
    """Number of stages; in each, every courier docks once."""
    stage_s: float = 2.2
    """Time for each stage, s."""
    travel_s: float = 1.1
    """Time of the reference from one dock to the next, s."""
    success: Success = Success(0.02, 0.4)
    """The criterion of success of a stage, for couriers and hovering drones."""

    name = "delivery_v0"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 7, **DOWNWASH_DEFAULTS}
    goals_are = "the docks"
    learning = in_time({"docks": {}})

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and for options that contradict each other."""
        check_number("radius_m", self.radius_m, above=0.0, unit="m")
        for name in ("height_m", "above_m"):
            check_interval(name, getattr(self, name), above=0.0, unit="m")
        check_integer("stages", self.stages, at_least=1, at_most=100)
        for name in ("stage_s", "travel_s"):
            check_number(name, getattr(self, name), above=0.0, unit="s")
        check_type("success", self.success, Success)
        super().__post_init__()
        if len(self.team) > 3 * DOCKS:
            raise ValueError(
                f"team has {len(self.team)} drones, but delivery has room for {DOCKS} couriers and "
                f"two drones above each of {DOCKS} docks; use at most {3 * DOCKS} drones"
            )
        lowest, widest = self.height_m[0], max(v.radius for v in self.team[:DOCKS])
        if lowest < widest:
            raise ValueError(
                f"couriers dock at {lowest} m, but the largest of the first {DOCKS} drones, which "
                f"are the couriers, touches the floor at {widest:.3f} m; begin the team with small "
                "drones, such as 'S*S*S*LL', or give a larger height_m"
            )
        if self.travel_s > self.stage_s:
            raise ValueError(
                f"travel_s is {self.travel_s}, but must not exceed stage_s, {self.stage_s}"
            )

    @classmethod
    def default_team(cls, options: Any) -> Team:
        """Return three couriers and large hovering drones."""
        return delivery_team(options.num_drones)

    @property
    def num_stages(self) -> int:
        """The number of stages."""
        return self.stages

    @property
    def motion(self) -> Motion:
        """Straight lines from dock to dock."""
        return Motion(LINES, RAMP, float(self.stage_s))

    @property
    def episode_s(self) -> float:
        """The time of all stages, s."""
        return self.stages * self.stage_s

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample rotation, heights, the docks below hovering drones, and the couriers' docks."""
        n, height, above = len(self.team), rng.uniform(*self.height_m), rng.uniform(*self.above_m)
        angle = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * np.arange(DOCKS) / DOCKS
        outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(DOCKS)], axis=1)
        dock = self.radius_m * outward + np.array([0.0, 0.0, height])
        covered, first = rng.permutation(DOCKS), rng.permutation(DOCKS)
        turn = 1 if rng.random() < 0.5 else -1
        begin = np.empty((n, 3))
        couriers = slice(min(n, DOCKS))
        begin[couriers] = (_OUTSIDE * self.radius_m * outward[first])[couriers]
        begin[couriers, 2] = _START_HEIGHT_M
        for k in range(n - DOCKS):
            begin[DOCKS + k] = dock[covered[k // 2]]
            begin[DOCKS + k, 2] += above + _SECOND_M * (k % 2)
        goals = np.repeat(begin[None], self.stages, axis=0)
        for stage in range(self.stages):
            goals[stage, couriers] = dock[(first + turn * stage) % DOCKS][couriers]
        return Placement(begin if start is None else start, goals, float(self.travel_s))
