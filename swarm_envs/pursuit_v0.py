"""Pursuit, version 0: stay at goals that move, that are swapped, or that are beside others.

    from swarm_envs import pursuit_v0
    env = pursuit_v0.parallel_env(num_drones=8, layout="chase")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; the observed
`task.goal` is where the goal is now, `task.reference_velocity` how it moves.

**Layouts.** `moving`: the goals are a formation whose centre flies an ellipse. `swap-goals`: goals
rest, and every 5 s each drone is given another's. `chase`: one drone's goal moves as in `moving`;
every other drone's goal is a place beside another drone, wherever that one is.

**Start.** In `moving` and `chase` at the goals: places drawn at least 0.4 m apart, an ellipse of
half axes 0.8 m and 0.3-0.8 m, up to 0.2 m up and down, either way round, its largest speed
0.6-1.2 m/s, reached after 2 s; who chases whom is drawn. In `swap-goals` at another's goal.

**Success.** By the clock: `share_on_goal`, the score, is the share of the drones' time, over the
whole clock, that they spend within 0.2 m of their goals. Success is 90 % of it; 50 % in
`swap-goals`, where half of the time goes into the ways.

**Rewards** (per drone, weights in `PursuitTask.reward_weights`): the terms of swap.

**End.** A drone that collides, tumbles (150 rad/s), or touches the floor, a wall or an obstacle is
terminated, and the others fly on (`on_contact="end_pair"`); the clock truncates all, after 20 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from swarm_envs.arguments import POSITIVE, POSITIVE_M, POSITIVE_S, Interval, OneOf, typed_options
from swarm_envs.envs.options import NumDrones, TaskOptions, task_views
from swarm_envs.physics.contact import ON_CONTACT
from swarm_envs.tasks.pursuit import REWARD_WEIGHTS, Layout, PursuitTask


@typed_options
@dataclass(frozen=True, kw_only=True)
class PursuitOptions(TaskOptions):
    """Options of a pursuit environment."""

    num_drones: NumDrones = 8
    """N small drones, if no team is given."""
    layout: Layout = "moving"
    """What goals do: `moving`, `swap-goals` or `chase`."""
    spacing_m: Annotated[float, POSITIVE_M] = 0.4
    """Smallest distance between two goals, m."""
    speed_m_s: Annotated[tuple[float, float], Interval(POSITIVE)] = (0.6, 1.2)
    """Range from which the largest speed of moving goals is drawn, m/s."""
    change_s: Annotated[float, POSITIVE_S] = 5.0
    """Time after which goals are swapped, s."""

    on_contact: Annotated[str, OneOf(ON_CONTACT)] = "end_pair"
    """What touching something ends: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    task_type: ClassVar[type[PursuitTask]] = PursuitTask
    """What `make_task` makes."""

    def make_task(self) -> PursuitTask:
        """Pursuits as these options say."""
        return self.task_type(
            team=self.vehicles,
            layout=self.layout,
            spacing_m=self.spacing_m,
            speed_m_s=self.speed_m_s,
            change_s=self.change_s,
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(PursuitOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
