"""Delivery, version 0: dock just above the floor, below others that hover, and move on.

    from swarm_envs import delivery_v0
    env = delivery_v0.parallel_env()

Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. Drones fly in the world
`"hall"` unless another is asked for, and each observes seven neighbours, and with `observe_load`
what thrust it and they have to spare.

**Team.** Three couriers, strong small ones; then large ones that hover above docks, two above each.
By default there are four, above two of three docks.

**Start.** Three docks lie 0.8 m from the centre; docked couriers are 0.093 to 0.103 m high, and
touch the floor at 0.06 m. The first large one hovers 0.28 to 0.36 m above, the second 0.35 m
higher.
Turn, heights, which docks have somebody above and who docks where are drawn. Couriers start
outside of their first dock, 0.5 m high; after each stage they move on to the next, all in the same
sense. `reset(options={"start": ...})` starts elsewhere. Goals cannot be given.

**Success.** A stage is reached when every drone was within 0.02 m of its goal for 0.4 s before the
next begins, after 2.2 s; success when all three were, without a collision.

**Rewards** (per drone, weights in `DeliveryTask.reward_weights`): as in swap; `success` is one over
the number of stages, for each that is reached.

**End.** Who touches a drone, the floor, a wall or an obstacle, or tumbles (150 rad/s), has ended,
and the others fly on: see `on_contact`. Terminated when nobody is left, or at success; truncated by
the clock, after 6.6 s.

**Versions.** v0: the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from swarm_envs.arguments import typed_options
from swarm_envs.envs.options import AirTaskOptions, NumDrones, task_views
from swarm_envs.tasks.delivery import DeliveryTask, delivery_team
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.vehicles import Team


@typed_options
@dataclass(frozen=True, kw_only=True)
class DeliveryOptions(AirTaskOptions):
    """Options of a delivery environment."""

    num_drones: NumDrones = 7
    """N drones, at most 9, if no team is given: three couriers, the others hover."""

    default_weights: ClassVar[Mapping[str, float]] = REWARD_WEIGHTS
    """Weight of each reward term that is not given."""

    @property
    def vehicles(self) -> Team:
        """The team: as given, else couriers and large ones."""
        return delivery_team(self.num_drones) if self.team is None else super().vehicles

    def make_task(self) -> DeliveryTask:
        """Deliveries as these options say."""
        return DeliveryTask(
            team=self.vehicles,
            reward_weights=self.weights,
            obstacles=self.standing,
        )


blueprint, parallel_env, env = task_views(DeliveryOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
