"""Pursuit: goals that move, that are swapped repeatedly, or that follow other drones.

The goals resemble the dynamic goals of quad-swarm-rl (Huang et al. 2024), in which drones follow an
evader or swap goals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.random import Generator

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_interval, check_name, check_number, check_type
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import ByScore, Given, Orbit, Placement, Task
from swarm_envs.tasks.learning import scored
from swarm_envs.tasks.motion import PURSUIT, REST, Motion
from swarm_envs.tasks.placing import derangement, draw_apart, drawing_box
from swarm_envs.tasks.scores import SCORED_WEIGHTS, end_by_score

__all__ = ["PURSUIT_LAYOUTS", "REWARD_WEIGHTS", "Layout", "PursuitTask"]

Layout = Literal["moving", "swap-goals", "chase"]
"""The name of a layout."""
PURSUIT_LAYOUTS: tuple[str, ...] = get_args(Layout)
"""The names of the layouts."""
_ACROSS, _UPWARDS = 0.8, 0.2
"""Largest half axes of the center's ellipse, horizontal and vertical, m."""
_LOWEST, _HIGHEST = 0.5, 2.0
"""Heights of goals in an arena 2.5 m high, m; the highest grows with it."""
_SPARE = 0.15  # Further distance from the walls of goals that follow drones, m
_STARTUP_S = 2.0  # Time until goals move at full speed, s
_RADIUS = 0.2
_LEAST = {"moving": 0.9, "swap-goals": 0.5, "chase": 0.9}

REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType({**SCORED_WEIGHTS, "at_goal": 0.5})
"""Default weight of each reward term."""


@kernel
def score_pursuit(
    flown: BoolArray, drones: Records, environments: Records, goals: FloatArray, settings: Records
) -> None:
    """Count the time that drones spend near their goals.

    The arguments are those of `Task.advance`.
    """
    rules, size = settings[0], drones.shape[1]
    for e in range(drones.shape[0]):
        if not flown[e]:
            continue
        near, stage = 0, environments[e].stage
        swapped = environments[e].time - stage * rules.stage_s < rules.decision_s / 2
        for i in range(size):
            d = drones[e, i]
            if stage > 0 and swapped:  # `progress` counts the motion toward the previous goal
                square = 0.0
                for k in range(3):
                    square += (d.position[k] - goals[e, stage - 1, i, k]) ** 2
                d.last_distance += d.distance - np.sqrt(square)
            near += d.active > 0.0 and d.distance < rules.success_radius
        environments[e].score += near / size * rules.decision_s / rules.horizon_s
        end_by_score(environments[e], drones[e], rules)


@dataclass(frozen=True)
class PursuitTask(Task):
    """Pursuit, version 0: drones stay at goals that move, are swapped, or follow other drones.

        from swarm_envs import pursuit_v0
        env = pursuit_v0.parallel_env(num_drones=8, layout="chase")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`. `task.goal`
    is the present position of the goal, `task.reference_velocity` its velocity.

    **Layouts.** `moving`: the goals are a formation whose center moves on an ellipse. `swap-goals`:
    goals rest, and every 5 s each drone receives the goal of another. `chase`: the goal of one
    drone moves as in `moving`; the goal of every other drone keeps a constant offset from another
    drone.

    **Start.** `moving` and `chase`: at the goals, which are sampled at least 0.4 m apart. The
    ellipse has half axes of 0.8 m and 0.3-0.8 m and rises and falls by up to 0.2 m. Goals move in
    either direction with a largest speed of 0.6-1.2 m/s, reached after 2 s. The drone that each
    drone chases is random. `swap-goals`: at the goal of another drone.

    **Success.** At the time limit: no drone has crashed, and the score is at least 0.9, in
    `swap-goals` 0.5, since half of the time is needed for the paths. The score is the metric
    `share_on_goal`: the share of the drones' time, over the whole episode length, within 0.2 m of
    their goals.

    **Rewards** (`parallel_env` lists terms and weights): as in swap.

    **End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision,
    the floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes
    are truncated after 20 s.

    **Versions.** v0: first version.
    """

    layout: Layout = "moving"
    """Motion of goals: `moving`, `swap-goals` or `chase`."""
    spacing_m: float = 0.4
    """Smallest distance between two goals, m."""
    speed_m_s: tuple[float, float] = (0.6, 1.2)
    """Range of the largest speed of moving goals, m/s."""
    change_s: float = 5.0
    """Time between two swaps of goals, s."""
    success: ByScore | None = None  # type: ignore[assignment]  # set below
    """The distance at which a drone counts as at its goal, m, and the least share of time of a
    success; None: the layout's."""

    name = "pursuit_v0"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 8, "on_contact": "end_pair"}
    layouts = PURSUIT_LAYOUTS
    default_weights = REWARD_WEIGHTS
    episode_s = 20.0
    """Time limit, s."""
    score_names = ("share_on_goal",)
    advance = staticmethod(score_pursuit)
    learning = scored(PURSUIT_LAYOUTS, "share_on_goal", 1.0)

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values; set the layout's success."""
        check_name("layout", self.layout, PURSUIT_LAYOUTS)
        check_number("spacing_m", self.spacing_m, above=0.0, unit="m")
        check_interval("speed_m_s", self.speed_m_s, above=0.0)
        check_number("change_s", self.change_s, above=0.0, unit="s")
        check_type("success", self.success, ByScore | None)
        super().__post_init__()
        if self.success is None:
            object.__setattr__(self, "success", ByScore(_RADIUS, _LEAST[self.layout]))

    @property
    def num_stages(self) -> int:
        """The number of sets of goals within the time limit."""
        return math.ceil(self.episode_s / self.change_s) if self.layout == "swap-goals" else 1

    @property
    def motion(self) -> Motion:
        """Rest at the goals in `swap-goals`; else on ellipses and next to other drones."""
        if self.layout == "swap-goals":
            return Motion(REST, stage_s=self.change_s)
        return Motion(PURSUIT, _STARTUP_S)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample an episode; given starts, and goals in `swap-goals`, are used as they are.

        Raises:
            ValueError: a goal is given, but goals move in this layout.
            RuntimeError: no room for the goals was found in a bounded number of samples.
        """
        if goal is not None and self.layout != "swap-goals":
            raise ValueError(f"a goal is given, but in {self.layout!r} goals move; leave it out")
        if self.layout == "swap-goals":
            return self._draw_swaps(rng, start, goal)
        n = len(self.team)
        centers = self._points(rng, _ACROSS + _SPARE * (self.layout == "chase"), _UPWARDS)
        orbit = self._orbit(rng, centers)
        first = orbit.at(orbit.phase)
        start = first if start is None else start
        if self.layout == "moving":
            return Placement(start, first[None], orbit=orbit)
        order, chased = rng.permutation(n), np.full(n, -1)
        for k in range(1, n):
            chased[order[k]] = order[rng.integers(k)]
        follows = chased >= 0
        orbit.center[follows] -= centers[chased[follows]]
        orbit.first[follows] = orbit.second[follows] = 0.0
        return Placement(start, first[None], orbit=orbit, chased=chased)

    def _draw_swaps(self, rng: Generator, start: Given, goal: Given) -> Placement:
        """Sample points, and their assignments as goals: never the same twice in a row."""
        n, points = len(self.team), start if start is not None else goal
        if points is None:
            points = self._points(rng, 0.0, 0.0)
        orders = [np.arange(n)]
        for _ in range(self.num_stages):
            orders.append(orders[-1][derangement(rng, n) if n > 1 else [0]])
        stages = np.stack([points[order] for order in orders])
        if goal is not None:
            stages[1:] = goal[np.stack(orders[:-1])]
        return Placement(stages[0] if start is None else start, stages[1:])

    def _points(self, rng: Generator, across: float, upwards: float) -> FloatArray:
        """Sample points (N, 3), m, at least these distances, m, from the sides of the box."""
        (low, high), moved = drawing_box(self.arena, _LOWEST, _HIGHEST), (across, across, upwards)
        return draw_apart(rng, low + moved, high - moved, len(self.team), self.spacing_m)

    def _orbit(self, rng: Generator, centers: FloatArray) -> Orbit:
        """Sample an ellipse for all drones, about their centers, with a speed and a direction."""
        n, turn = len(centers), rng.uniform(0.0, 2 * np.pi)
        across, upwards = _ACROSS * rng.uniform(0.4, 1.0), _UPWARDS * rng.uniform(-1.0, 1.0)
        first = _ACROSS * np.array([math.cos(turn), math.sin(turn), 0.0])
        second = np.array([-across * math.sin(turn), across * math.cos(turn), upwards])
        rate = rng.uniform(*self.speed_m_s) / _ACROSS * rng.choice([-1.0, 1.0])
        phase = rng.uniform(0.0, 2 * np.pi)
        each = np.tile(first, (n, 1)), np.tile(second, (n, 1))
        return Orbit(centers.copy(), *each, np.full(n, rate), np.full(n, phase))
