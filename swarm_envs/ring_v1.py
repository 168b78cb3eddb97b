"""Ring, version 1: drones track references on intertwined rings, through each other's downwash.

    from swarm_envs import ring_v1
    env = ring_v1.parallel_env(num_drones=5, action="setpoint")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`. The goal, which
is observed as `task.goal`, is the present position of the reference.

**Teams.** 5 drones (the default, `S*S*S*LL`): three small drones on a vertical circle and two large
drones on a horizontal circle of the same radius, 0.55 m, at 0.65 m/s; a small drone is at its
lowest point when a large one is right above it. 16 drones (`LSSLSS` and ten `S*`): two large and
four small drones on a horizontal ellipse of 1.0 x 0.6 m, five and five on vertical circles of 0.5 m
at its tips, at 0.5 m/s. Other teams follow the same rule: see `swarm_envs.tasks.ring`.
`rings=RingLayout(...)` changes sizes and speeds: `swarm_envs.tasks.ring.CLOSE_SIXTEEN` has those of
Neural-Swarm2, Fig. 1, whose references come within 0.26 m, and `CLOSE_FIVE` is alike for Fig. 9.

**Start.** On the rings, at rest, with fixed phases; the flight time by which the whole team is
ahead is drawn from 0-60 s. The speed grows smoothly within 2 s. `reset(options={"start": ...})`
sets other starts; the reference stays the same. Goals cannot be set.

**Success.** No collision until the time limit, and after the first 2 s every drone stays within
0.15 m of its reference. Success is known, and rewarded, at the time limit.

**Rewards** (`parallel_env` lists terms and weights): as in swap, with `tracking` in place of
`progress` and `at_goal`.

**End.** The episode is terminated by a collision, the floor, a wall, an obstacle or tumbling (150
rad/s). It is truncated after 2 + 10 s.

**Versions.** v1: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import TaskOptions, task_views
from swarm_envs.tasks.ring import RingLayout, RingTask, ring_team
from swarm_envs.vehicles import Team


@dataclass(frozen=True, kw_only=True)
class RingOptions(TaskOptions):
    """Options of a ring environment."""

    num_drones: int = 5
    """N drones, if no team is given: the paper's teams for 5 and 16, else small ones."""
    rings: RingLayout | None = None
    """Sizes, speed and phases of the rings."""

    @property
    def vehicles(self) -> Team:
        """The team: as given, else that of the paper."""
        return ring_team(self.num_drones) if self.team is None else super().vehicles

    task_type = RingTask


blueprint, parallel_env, env = task_views(RingOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
