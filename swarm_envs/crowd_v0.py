"""Crowd, version 0: many drones at constant density fly from goal to goal between obstacles.

    from swarm_envs import crowd_v0
    env = crowd_v0.parallel_env(num_drones=64, layout="forest")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`.

**Layouts.** `open`: no obstacles. `forest`: columns of radius 0.15 m, one per square of 1.2 m,
each slightly displaced. `buildings`: towers 0.45 m wide on a grid of 1.4 m. Obstacles reach the
ceiling and are the same in every episode. The arena grows with the number of drones.

**Start.** Three sites per drone are sampled, at least 0.5 m apart and free of obstacles. Each drone
starts at one; its goal is another, 1-3 m away if one is free.

**Goals.** A drone within 0.15 m of its goal has reached it, at any speed, and receives another at
once: a site that no drone has, 1-3 m away if one is free, sampled with the episode's seed.

**Success.** At the time limit: no drone has crashed, and the score is at least 16, 70 % of what a
single drone reaches in an open arena on straight lines. The score is the metric
`throughput_per_min`: goals reached, per drone and minute of the whole episode length. A drone that
has ended reaches no more.

**Rewards** (`parallel_env` lists terms and weights): as in swap, and `reached`, 1 for each goal
that the drone reaches.

**End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision, the
floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes are
truncated after 30 s.

**Versions.** v0: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.tasks.crowd import CrowdTask, Layout


@dataclass(frozen=True, kw_only=True)
class CrowdOptions(TaskOptions):
    """Options of a crowd environment."""

    num_drones: int = 16
    """N small drones, if no team is given."""
    layout: Layout = "forest"
    """Obstacles: `open`, `forest` or `buildings`; `obstacles` are added."""
    spacing_m: float = 0.5
    """Smallest distance between two goals, and between two starts, m."""
    reach_m: tuple[float, float] = (1.0, 3.0)
    """Range of the distance of the next goal, if one is free there, m."""

    on_contact: str = "end_pair"
    """Effect of a contact: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    task_type = CrowdTask


blueprint, parallel_env, env = task_views(CrowdOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
