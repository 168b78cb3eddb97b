"""Delivery, version 0: drones dock just above the floor, below others that hover, and move on.

    from swarm_envs import delivery_v0
    env = delivery_v0.parallel_env()

Agents, actions, arena and frames are those of `swarm_envs.swap_v1`. By default drones fly in the
world `"hall"`, and each observes seven neighbors and, with `observe_load`, the thrust margin, mass
and charge of itself and of its neighbors.

**Team.** Three couriers, which are strong small drones; then large drones that hover above docks,
two above each. By default there are four, above two of three docks.

**Start.** Three docks are 0.8 m from the center; docked couriers are 0.093 to 0.103 m high, and
touch the floor at 0.06 m. The first large drone hovers 0.28 to 0.36 m above, the second 0.35 m
higher. Rotation, heights, the docks below large drones, and the first dock of each courier are
random. Couriers start outside their first dock, 0.5 m high; after each stage they move to the next,
all in the same direction. `reset(options={"start": ...})` sets other starts. Goals cannot be set.

**Success.** A stage of 2.2 s is reached if every drone was within 0.02 m of its goal for 0.4 s.
Success: all three stages were reached, without a collision.

**Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is one over the number
of stages, for each stage reached.

**End.** By default (`on_contact="end_pair"`) a drone's episode is terminated by a collision, the
floor, a wall, an obstacle or tumbling (150 rad/s), and the others continue. All episodes are
terminated by success and truncated after 6.6 s.

**Versions.** v0: first version.
"""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.envs.options import AirTaskOptions, task_views
from swarm_envs.tasks.delivery import DeliveryTask, delivery_team
from swarm_envs.vehicles import Team


@dataclass(frozen=True, kw_only=True)
class DeliveryOptions(AirTaskOptions):
    """Options of a delivery environment."""

    num_drones: int = 7
    """N drones, at most 9, if no team is given: three couriers, the others hover."""

    task_type = DeliveryTask

    @property
    def vehicles(self) -> Team:
        """The team: as given, else couriers and large ones."""
        return delivery_team(self.num_drones) if self.team is None else super().vehicles


blueprint, parallel_env, env = task_views(DeliveryOptions)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
