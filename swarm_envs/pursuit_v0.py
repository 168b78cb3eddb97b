"""Pursuit, version 0: drones stay at goals that move, are swapped, or follow other drones.

    from swarm_envs import pursuit_v0
    env = pursuit_v0.parallel_env(num_drones=8, layout="chase")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`.
`task.goal` is the present position of the goal, `task.reference_velocity` its velocity.

**Layouts.** `moving`: the goals are a formation whose center flies an ellipse. `swap-goals`: goals
rest, and every 5 s each drone receives the goal of another. `chase`: the goal of one drone moves as
in `moving`; the goal of every other drone is a place next to another drone, wherever that one is.

**Start.** `moving` and `chase`: at the goals, which are sampled at least 0.4 m apart. The ellipse
has half axes of 0.8 m and 0.3-0.8 m, rises and falls by up to 0.2 m, in either direction, with a
largest speed of 0.6-1.2 m/s, reached after 2 s. The drone that each drone chases is random.
`swap-goals`: at the goal of another drone.

**Success.** At the time limit: no drone has crashed, and the score is at least 0.9, in `swap-goals`
0.5, since half of the time is needed for the paths. The score is the metric `share_on_goal`: the
share of the drones' time, over the whole episode length, within 0.2 m of their goals.

**Rewards** (`parallel_env` lists terms and weights): as in swap.

**End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision, the
floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes are
truncated after 20 s.

**Versions.** v0: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.tasks.pursuit import Layout, PursuitTask


@dataclass(frozen=True, kw_only=True)
class PursuitOptions(TaskOptions):
    """Options of a pursuit environment."""

    num_drones: int = 8
    """N small drones, if no team is given."""
    layout: Layout = "moving"
    """Motion of goals: `moving`, `swap-goals` or `chase`."""
    spacing_m: float = 0.4
    """Smallest distance between two goals, m."""
    speed_m_s: tuple[float, float] = (0.6, 1.2)
    """Range from which the largest speed of moving goals is drawn, m/s."""
    change_s: float = 5.0
    """Time between two swaps of goals, s."""

    on_contact: str = "end_pair"
    """Effect of a contact: `end_team`, `end_pair` or `bounce`; see `EnvConfig`."""

    task_type = PursuitTask


blueprint, parallel_env, env = task_views(PursuitOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
