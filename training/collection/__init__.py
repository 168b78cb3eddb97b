"""Collection of flight logs in the environment, of drones that fly through each other's wakes.

It corresponds to Neural-Swarm2, Sec. VII-B. Order of reading: `collect` (configuration and files),
`motion` (random walks, stacked swaps), `flight` (the simulation loop), `log` (logs, sensor noise,
interaction force), `table` (rows for the trainer).
`swarm_envs.training.belief` fits the deep set of the compensated controller to them.

Command: `swarm-envs collect --out DIR --seed 0`; the page is docs/flight-logs.md.
"""

from swarm_envs.training.collection.collect import CollectionConfig, collect
from swarm_envs.training.collection.log import SensorNoise, interaction_force
from swarm_envs.training.collection.table import interaction_rows

__all__ = [
    "CollectionConfig",
    "SensorNoise",
    "collect",
    "interaction_force",
    "interaction_rows",
]
