"""Collection of flights inside the environment: logs of drones that fly through each other's wakes.

The environment's counterpart of Neural-Swarm2, Sec. VII-B. Order of reading: `config` (what is
flown), `motion` and `potentials` (random walks, stacked swaps), `fleet` (vehicles that differ from
their type), `log` and `flight` (the loop and what it logs), `sensors` (their noise), `labels`
(interaction force from a log), `table` (rows for the trainer), `signals` and `storage` (files),
`collect` (all flights to a folder). `swarm_envs.training.belief` fits the deep set that the
compensated controller believes to them.

Command: `swarm-envs collect --out DIR --seed 0`; the page is docs/collect.md.
"""

from swarm_envs.training.collection.collect import collect, read_flights
from swarm_envs.training.collection.config import CollectionConfig
from swarm_envs.training.collection.fleet import CalibrationErrors
from swarm_envs.training.collection.labels import interaction_force
from swarm_envs.training.collection.log import FlightLog
from swarm_envs.training.collection.sensors import SensorNoise
from swarm_envs.training.collection.table import interaction_rows

__all__ = [
    "CalibrationErrors",
    "CollectionConfig",
    "FlightLog",
    "SensorNoise",
    "collect",
    "interaction_force",
    "interaction_rows",
    "read_flights",
]
