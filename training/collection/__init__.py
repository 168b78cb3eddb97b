"""Collection of flights inside the environment: logs of drones that fly through each other's wakes.

The environment's counterpart of Neural-Swarm2, Sec. VII-B. Order of reading: `config` (what is
flown), `motion` (random walks with potentials, stacked swaps), `flight` (the loop and its log),
`labels` (interaction force from a log), `table` (rows for the trainer), `collect` (all flights to
a folder). `belief` fits the deep set that the compensated controller believes.

Command: `python -m swarm_envs.training.collection --out DIR --seed 0`.
"""

from swarm_envs.training.collection.collect import collect, read_flights
from swarm_envs.training.collection.config import CollectionConfig
from swarm_envs.training.collection.flight import FlightLog, SensorNoise
from swarm_envs.training.collection.labels import interaction_force
from swarm_envs.training.collection.table import interaction_rows

__all__ = [
    "CollectionConfig",
    "FlightLog",
    "SensorNoise",
    "collect",
    "interaction_force",
    "interaction_rows",
    "read_flights",
]
