"""Crowd: many drones at constant density fly from goal to goal until the time limit.

Goals are sites, sampled once per episode with a minimum distance and free of obstacles. A drone has
one site as its goal; when it reaches it, another free site is sampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.random import Generator

from swarm_envs.compiled import kernel, part
from swarm_envs.errors import check_interval, check_name, check_number, check_type
from swarm_envs.noise import even_number
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import ByScore, Given, Placement, Task
from swarm_envs.tasks.learning import scored
from swarm_envs.tasks.motion import Motion
from swarm_envs.tasks.obstacles import Column, Obstacle, buildings
from swarm_envs.tasks.placing import OBSTACLE_MARGIN, arena_of, draw_apart, drawing_box
from swarm_envs.tasks.rewards import REWARD_NAMES, write_terms
from swarm_envs.tasks.scores import SCORED_WEIGHTS, end_by_score, send_to

__all__ = ["CROWD_LAYOUTS", "REWARD_WEIGHTS", "CrowdTask", "Layout"]

Layout = Literal["open", "forest", "buildings"]
"""The name of a layout."""
CROWD_LAYOUTS: tuple[str, ...] = get_args(Layout)
"""The names of the layouts."""
_SITES = 3  # Sites per drone: its goal and two free ones
_LOWEST, _HIGHEST = 0.5, 2.0
"""Heights of sites in an arena 2.5 m high, m; the highest grows with it."""
_TREES_M, _TREE_RADIUS, _TREE_SHIFT = 1.2, 0.15, 0.2
_TOWERS_M, _TOWER_WIDTH = 1.4, 0.45

REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType({**SCORED_WEIGHTS, "reached": 1.0})
"""Default weight of each reward term."""


def crowd_obstacles(layout: str, num_drones: int) -> tuple[Obstacle, ...]:
    """Return the obstacles of a layout for a number of drones, the same in every episode.

    `forest`: columns of radius 0.15 m, one for each square of 1.2 m, shifted by up to 0.2 m along
    x and y. `buildings`: towers 0.45 m wide on a grid of 1.4 m. Both reach the ceiling.
    """
    width = 2.0 * float(arena_of(num_drones)[1, 0])
    if layout == "buildings":
        count = int((width - _TOWER_WIDTH) / _TOWERS_M)
        return buildings(count, count, spacing=_TOWERS_M, width=_TOWER_WIDTH)
    if layout == "open":
        return ()
    rng, count = np.random.default_rng(0), int(width / _TREES_M)
    middle = _TREES_M * (np.arange(count) - (count - 1) / 2)
    shift = rng.uniform(-_TREE_SHIFT, _TREE_SHIFT, (count, count, 2))
    return tuple(
        Column((float(middle[i] + shift[i, j, 0]), float(middle[j] + shift[i, j, 1])), _TREE_RADIUS)
        for i in range(count)
        for j in range(count)
    )


@part
def next_site(
    position: FloatArray, goals: FloatArray, near: float, far: float, chance: float
) -> int:
    """Return the index of a free site at a distance between two limits; of any, if there is none.

    Args:
        position: (3,) position of the drone, m.
        goals: (S, N, 3) sites, m; the first N are occupied.
        near: least distance, m.
        far: largest distance, m.
        chance: a number in (0, 1), which determines the site at which the search begins.
    """
    size = goals.shape[1]
    free = (goals.shape[0] - 1) * size
    first = np.int64(chance * free)
    for c in range(free):
        site = size + (first + c) % free
        square = 0.0
        for k in range(3):
            square += (goals[site // size, site % size, k] - position[k]) ** 2
        if near * near <= square <= far * far:
            return site
    return size + first


@kernel
def give_next_goals(
    flown: BoolArray, drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Count the goals that were reached in this decision, and give their drones new ones.

    The arguments are those of `Task.advance`.
    """
    rules, size = settings[0], drones.shape[1]
    for e in range(drones.shape[0]):
        if not flown[e]:
            continue
        environment = environments[e]
        for i in range(size):
            d = drones[e, i]
            d.scores = 0.0
            if d.active == 0.0 or d.crashed > 0.0 or d.distance >= rules.success_radius:
                continue
            d.scores = 1.0
            chance = even_number(environment.goal_key, environment.goals_reached)
            environment.goals_reached += 1
            near, far = rules.goal_reach[0], rules.goal_reach[1]
            site = next_site(d.position, goals[e], near, far, chance)
            for k in range(3):
                old, new = goals[e, 0, i, k], goals[e, site // size, site % size, k]
                goals[e, 0, i, k], goals[e, site // size, site % size, k] = new, old
            send_to(d, goals[e, 0, i])
        environment.score = environment.goals_reached / (size * rules.horizon_s / 60.0)
        end_by_score(environment, drones[e], rules)


@kernel
def write_crowd_terms(
    drones: Records, environments: Records, settings: Records, out: FloatArray
) -> None:
    """Write the seven terms of `write_terms` and a further one.

    - `reached`: 1 for each goal that the drone reaches.
    """
    write_terms(drones, environments, settings, out)
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            out[7, e, i] = drones[e, i].scores


_COLUMNS = (Column((1.0, 1.0), 0.15), Column((-0.7, -0.4), 0.15))
"""Obstacles of further training environments, in which fewer obstacles than M are present. Without
such observations in training, a policy hovered 0.4 m off its goals."""


@dataclass(frozen=True)
class CrowdTask(Task):
    """Crowd, version 0: many drones at constant density fly from goal to goal between obstacles.

        from swarm_envs import crowd_v0
        env = crowd_v0.parallel_env(num_drones=64, layout="forest")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`.

    **Layouts.** `open`: no obstacles. `forest`: columns of radius 0.15 m, one per square of 1.2 m,
    each slightly displaced. `buildings`: towers 0.45 m wide on a grid of 1.4 m. Obstacles reach the
    ceiling and are the same in every episode. The arena grows with the number of drones.

    **Start.** Three sites per drone are sampled, at least 0.5 m apart and free of obstacles. Each
    drone starts at one; its goal is another, 1-3 m away if one is free.

    **Goals.** A drone within 0.15 m of its goal has reached it, at any speed, and receives another
    at once: a site that is no drone's goal, 1-3 m away if one is free, sampled with the episode's
    seed.

    **Success.** At the time limit: no drone has crashed, and the score is at least 16, 70 % of the
    score of a single drone on straight lines in an open arena. The score is the metric
    `throughput_per_min`: goals reached per drone and minute of the whole episode length.

    **Rewards** (`parallel_env` lists terms and weights): as in swap, and `reached`, 1 for each goal
    that the drone reaches.

    **End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision,
    the floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes
    are truncated after 30 s.

    **Versions.** v0: first version.
    """

    layout: Layout = "forest"
    """Obstacles: `open`, `forest` or `buildings`; `obstacles` are added."""
    spacing_m: float = 0.5
    """Smallest distance between two goals, and between two starts, m."""
    reach_m: tuple[float, float] = (1.0, 3.0)
    """Range of the distance to the next goal, if a site is free there, m."""
    success: ByScore = ByScore(radius=0.15, least=16.0)
    """The distance at which a goal counts as reached, m, and the least throughput of a success,
    goals per drone and minute."""

    name = "crowd_v0"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 16, "on_contact": "end_pair"}
    layouts = CROWD_LAYOUTS
    default_weights = REWARD_WEIGHTS
    episode_s = 30.0
    """Time limit, s."""
    score_names = ("throughput_per_min", "goals_reached")
    reward_names = (*REWARD_NAMES, "reached")
    write_reward_terms = staticmethod(write_crowd_terms)
    advance = staticmethod(give_next_goals)
    learning = scored(
        CROWD_LAYOUTS,
        "throughput_per_min",
        40.0,
        {"buildings": {"reach_m": (0.8, 2.2)}},  # paths as short as those of the benchmark
        has_obstacles=True,
        beside={
            "column": {"layout": "open", "obstacles": _COLUMNS[:1]},
            "columns": {"layout": "open", "obstacles": _COLUMNS},
        },
    )

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values; add the layout's obstacles."""
        check_name("layout", self.layout, CROWD_LAYOUTS)
        check_number("spacing_m", self.spacing_m, above=0.0, unit="m")
        check_interval("reach_m", self.reach_m, above=0.0, unit="m")
        check_type("success", self.success, ByScore)
        super().__post_init__()
        own = crowd_obstacles(self.layout, len(self.team))
        given = tuple(o for o in self.obstacles if o not in own)
        object.__setattr__(self, "obstacles", (*own, *given))

    @property
    def num_stages(self) -> int:
        """The number of rows of N sites; the first row is the drones' goals."""
        return _SITES

    @property
    def motion(self) -> Motion:
        """Rest at the goals."""
        return Motion()

    @property
    def rules(self) -> dict[str, Any]:
        """The range of distances to the next goal."""
        return {"goal_reach": self.reach_m}

    @cached_property
    def _room(self) -> tuple[FloatArray, FloatArray, float]:
        """The corners of the box of sites, and their least distance from obstacles, m."""
        box = drawing_box(self.arena, _LOWEST, _HIGHEST)
        return *box, OBSTACLE_MARGIN + float(self.radius.max())

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample sites, and among them starts and first goals; given ones are used as they are.

        Raises:
            RuntimeError: no room for the sites was found in a bounded number of samples.
        """
        n, (low, high, margin) = len(self.team), self._room
        rows, count = self.obstacle_rows, _SITES * n
        sites = draw_apart(rng, low, high, count, self.spacing_m, rows, margin, goal)
        start = sites[-n:].copy() if start is None else start
        if goal is None:
            sites = self._goals_first(rng, start, sites)
        key = int(rng.integers(2**64, dtype=np.uint64))
        return Placement(start, sites.reshape(_SITES, n, 3), key=key)

    def _goals_first(self, rng: Generator, start: FloatArray, sites: FloatArray) -> FloatArray:
        """Return the sites in an order in which the first N are the goals for these starts."""
        free, chosen = np.ones(len(sites), dtype=np.bool_), []
        for point in start:
            away = np.sqrt(((sites - point) ** 2).sum(axis=1))
            fits = free & (away >= self.reach_m[0]) & (away <= self.reach_m[1])
            chosen.append(int(rng.choice((fits if fits.any() else free).nonzero()[0])))
            free[chosen[-1]] = False
        return np.concatenate([sites[chosen], sites[free]])
