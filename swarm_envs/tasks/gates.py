"""Gates: a team in a vertical column flies a slalom, with all drones in each gate at once.

In each gate, drones are in the downwash of those above, since they must be in a column at the same
time; between gates they may fly as they like.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_interval, check_number
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import ByScore, Given, Placement, Task
from swarm_envs.tasks.learning import RATES, Learning, metric
from swarm_envs.tasks.motion import OWN_GOALS, Motion
from swarm_envs.tasks.obstacles import Column
from swarm_envs.tasks.scores import SCORED_WEIGHTS, send_to

__all__ = ["REWARD_WEIGHTS", "GatesTask"]

_GATES = tuple((-1.2 + 0.8 * k, 0.4 if k % 2 else -0.4) for k in range(4))
"""Positions of the gates, x and y, m."""
_HALF_WIDTH, _POST = 0.35, 0.05
"""Half the distance between the posts of a gate, and their radius, m."""
_START_X = -1.65
_CEILING = 2.2  # Largest height of a column, m

REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType({**SCORED_WEIGHTS, "success": 10.0})
"""Default weight of each reward term."""


@kernel
def pass_gates(
    flown: BoolArray, drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Give a team whose drones are all in a gate the next gate; the last one ends the episode.

    The arguments are those of `Task.advance`.
    """
    rules, size, stages = settings[0], drones.shape[1], goals.shape[1]
    for e in range(drones.shape[0]):
        environment = environments[e]
        if not flown[e] or environment.terminated or environment.reached == stages:
            continue
        left, inside, crash_free = 0, True, True
        for i in range(size):
            d = drones[e, i]
            left += d.active > 0.0
            crash_free &= d.incidents == 0.0
            inside &= d.active == 0.0 or d.distance < rules.success_radius
        if not inside:
            continue
        environment.reached += 1
        environment.achieved = 1.0 / stages
        environment.goals_reached += left
        minutes = rules.horizon_s / 60.0
        if environment.reached == stages:
            minutes = environment.time / 60.0
            environment.succeeded = crash_free
            environment.terminated = rules.end_on_success
            environment.truncated &= not environment.terminated
            environment.running &= not environment.terminated
        else:
            for i in range(size):
                send_to(drones[e, i], goals[e, environment.reached, i])
        environment.score = environment.goals_reached / size / minutes


@dataclass(frozen=True)
class GatesTask(Task):
    """Gates, version 0: a team flies a slalom and passes each gate together, in a column.

        from swarm_envs import gates_v0
        env = gates_v0.parallel_env(team="LSS")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; `task.goal`
    is the drone's slot in the next gate. The default world is `"hall"`.

    **Gates.** Four gates, 0.8 m apart along x, alternate between 0.4 m left and right. Each is a
    gap of 0.7 m between two posts of radius 0.05 m, which are obstacles. The team flies through
    them in both directions.

    **Start.** A column before the first gate, at either end. The order of drones in the column,
    their vertical distance (0.3-0.4 m) and the height of the lowest slot in each gate (0.4-0.8 m)
    are random. `reset(options={"start": ...})` sets other starts. Goals cannot be set.

    **Passing a gate.** A gate is passed on the step on which every active drone is within 0.05 m of
    its slot in it; the goals are then the slots in the next gate.

    **Success.** All eight gates are passed within the time limit, without a crash. The score is
    `gates_per_min`: gates passed per minute until the last one, or of the whole episode length if
    not all were passed. A gate that part of the team passed counts for that part.

    **Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is 1/8 for each
    gate.

    **End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision,
    the floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes
    are terminated by success and truncated after 30 s.

    **Versions.** v0: first version.
    """

    gap_m: tuple[float, float] = (0.3, 0.4)
    """Range of the vertical distance between neighbors in the column, m."""
    lowest_m: tuple[float, float] = (0.4, 0.8)
    """Range of the height of the lowest slot, sampled for each gate, m."""
    radius_m: float = 0.05
    """Largest distance of a drone from its slot in a passed gate, m."""

    name = "gates_v0"
    defaults: ClassVar[Mapping[str, Any]] = {
        "num_drones": 3,
        "world": "hall",
        "on_contact": "end_pair",
    }
    default_weights = REWARD_WEIGHTS
    goals_are = "the gates"
    episode_s = 30.0
    """Time limit, s."""
    score_names = ("gates_per_min", "places_passed")
    advance = staticmethod(pass_gates)
    learning = Learning(
        layouts={"slalom": {}},
        horizon_s=None,
        observe_load=True,
        has_obstacles=True,
        measures={**RATES, "gates_per_min": metric("gates_per_min")},
        cost={"gates_per_min": -1.0 / 80.0},
    )

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and columns that do not fit; add the posts."""
        for name in ("gap_m", "lowest_m"):
            check_interval(name, getattr(self, name), above=0.0, unit="m")
        check_number("radius_m", self.radius_m, above=0.0, unit="m")
        super().__post_init__()
        top = self.lowest_m[1] + self.gap_m[1] * (len(self.team) - 1)
        if top > _CEILING:
            raise ValueError(
                f"a column of {len(self.team)} drones with gaps up to {self.gap_m[1]} m reaches "
                f"{top:.2f} m, but must stay below {_CEILING} m; use fewer drones, smaller gap_m "
                "or lower lowest_m (--env gap_m=LOW,HIGH lowest_m=LOW,HIGH)"
            )
        sides = (-_HALF_WIDTH, _HALF_WIDTH)
        posts = tuple(Column((x, y + side), _POST) for x, y in _GATES for side in sides)
        given = tuple(o for o in self.obstacles if o not in posts)
        object.__setattr__(self, "obstacles", (*posts, *given))

    @property
    def success(self) -> ByScore:  # type: ignore[override]
        """The radius of the slots; `pass_gates` decides about success."""
        return ByScore(radius=self.radius_m, least=0.0)

    @property
    def num_stages(self) -> int:
        """The number of gates to pass: each in both directions."""
        return 2 * len(_GATES)

    @property
    def motion(self) -> Motion:
        """Rest at the slots in the next gate."""
        return Motion(OWN_GOALS)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample the column, the heights in the gates, and the end of the slalom at the start."""
        n, side = len(self.team), rng.choice([-1.0, 1.0])
        slots = rng.uniform(*self.gap_m) * rng.permutation(n)
        heights = rng.uniform(*self.lowest_m, len(_GATES) + 1)
        there = [side * np.array(gate) for gate in _GATES]
        goals = np.empty((2 * len(_GATES), n, 3))
        goals[:, :, :2] = np.array([*there, *reversed(there)])[:, None]
        goals[:, :, 2] = np.concatenate([heights[1:], heights[:0:-1]])[:, None] + slots
        begin = np.column_stack([np.full(n, side * _START_X), np.zeros(n), heights[0] + slots])
        return Placement(begin if start is None else start, goals)
