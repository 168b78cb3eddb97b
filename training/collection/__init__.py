"""Collection of flights inside the environment: logs of drones that fly through each other's wakes.

The environment's counterpart of Neural-Swarm2, Sec. VII-B. Order of reading: `collect` (what is
flown, all flights to a folder), `motion` (random walks, stacked swaps), `flight` (the loop), `log`
(what is logged and its file, the noise of sensors, the interaction force), `table` (rows for the
trainer).
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
