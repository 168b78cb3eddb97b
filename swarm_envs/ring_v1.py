"""Ring, version 1: keep to a reference on intertwined rings, through each other's downwash.

    from swarm_envs import ring_v1
    env = ring_v1.parallel_env(num_drones=5, action="setpoint")

Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`. Here the
observed `task.goal` is where the reference is now.

**Teams.** 5 drones (the default, `S*S*S*LL`): three small ones on an upright circle, two large ones
on a level circle of the same radius, 0.55 m, at 0.65 m/s; a small one is at its lowest when a large
one is right above. 16 drones (`LSSLSS` and ten `S*`): two large and four small ones on a level
ellipse of 1.0 x 0.6 m, five and five on upright circles of 0.5 m at its tips, at 0.5 m/s. Any other
team flies by the same rule: see `swarm_envs.tasks.ring`. Sizes, speed and phases:
`rings=RingLayout(...)`.

**Start.** On the rings, at rest, phases locked, the whole team ahead by a flight time drawn from
0-60 s. Within 2 s the rate grows smoothly from rest. `reset(options={"start": ...})` starts
elsewhere; the reference stays where it is. Goals cannot be given.

**Success.** No collision until the clock ends, and after the first 2 s no drone ever 0.15 m or more
from its reference. Known, and rewarded, at the end of the clock.

**Rewards** (per drone, weights in `RingTask.reward_weights`): as in swap, with `tracking` in place
of `progress` and `at_goal`.

**End.** Terminated by a collision, the floor, a wall, an obstacle or tumbling (150 rad/s);
truncated by the clock, after 2 + 10 s.

**Versions.** v1: the force model `learned` sums pairs of drones, so it stays physical in crowds;
returns do not depend on the clock. v0: forces (`learned-v0`) and rewards of release 0.1.0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from swarm_envs.arguments import typed_options
from swarm_envs.envs.options import NumDrones, TaskOptions, task_views
from swarm_envs.tasks.ring import REWARD_WEIGHTS, RingLayout, RingTask, ring_team
from swarm_envs.vehicles import Team


@typed_options
@dataclass(frozen=True, kw_only=True)
class RingOptions(TaskOptions):
    """Options of a ring environment."""

    num_drones: NumDrones = 5
    """N drones, if no team is given: the paper's teams for 5 and 16, else small ones."""
    rings: RingLayout | None = None
    """Sizes, speed and phases of the rings."""

    @property
    def vehicles(self) -> Team:
        """The team: as given, else that of the paper."""
        return ring_team(self.num_drones) if self.team is None else super().vehicles

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    task_type: ClassVar[type[RingTask]] = RingTask
    """What `make_task` makes."""

    def make_task(self) -> RingTask:
        """Rings as these options say."""
        return self.task_type(
            team=self.vehicles,
            rings=self.rings,
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(RingOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
