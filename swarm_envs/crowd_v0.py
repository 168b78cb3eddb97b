"""Crowd: many drones at constant density, goal after goal, between trees or buildings.

    from swarm_envs import crowd_v0
    env = crowd_v0.parallel_env(num_drones=64, layout="forest")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`.

**Layouts.** `open`; `forest`: columns of radius 0.15 m, one for each square of 1.2 m, each a little
off its place; `buildings`: towers 0.45 m wide on a grid of 1.4 m. They reach the ceiling, and are
the same in every episode. The arena grows with the number of drones.

**Start.** Sites, three for each drone, are drawn at least 0.5 m apart, free of obstacles; each
drone starts at one, and its goal is another, 1-3 m away where one is free.

**Goals.** A drone that comes within 0.15 m of its goal has reached it, whatever its speed, and is
given another at once: a site that no drone has, 1-3 m away where one is free, drawn with the
episode's seed.

**Success.** By the clock: a throughput of 16 goals a drone and minute or more, 70 % of what
one alone in an open arena reaches by straight lines. The metric `throughput_per_min` is the score:
goals reached, over drones and the whole clock; who has ended reaches no more.

**Rewards** (per drone, weights in `CrowdTask.reward_weights`): the terms of swap, and `reached`, 1
for each goal that the drone reaches.

**End.** A drone that collides, tumbles (150 rad/s), or touches the floor, a wall or an obstacle is
terminated, and the others fly on (`on_contact="end_pair"`); the clock truncates all, after 30 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from swarm_envs.arguments import POSITIVE_M, Interval, OneOf, typed_options
from swarm_envs.envs.options import NumDrones, TaskOptions, task_views
from swarm_envs.physics.contact import ON_CONTACT
from swarm_envs.tasks.crowd import REWARD_WEIGHTS, CrowdTask, Layout


@typed_options
@dataclass(frozen=True, kw_only=True)
class CrowdOptions(TaskOptions):
    """Options of a crowd environment."""

    num_drones: NumDrones = 16
    """N small drones, if no team is given."""
    layout: Layout = "forest"
    """What stands in the way: `open`, `forest` or `buildings`; `obstacles` are added."""
    spacing_m: Annotated[float, POSITIVE_M] = 0.5
    """Smallest distance between two goals, and between two starts, m."""
    reach_m: Annotated[tuple[float, float], Interval(POSITIVE_M)] = (1.0, 3.0)
    """How far from the drone its next goal is, where one is free there, m."""

    on_contact: Annotated[str, OneOf(ON_CONTACT)] = "end_pair"
    """What touching something ends: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    task_type: ClassVar[type[CrowdTask]] = CrowdTask
    """What `make_task` makes."""

    def make_task(self) -> CrowdTask:
        """Crowds as these options say."""
        return self.task_type(
            team=self.vehicles,
            layout=self.layout,
            spacing_m=self.spacing_m,
            reach_m=self.reach_m,
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(CrowdOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
