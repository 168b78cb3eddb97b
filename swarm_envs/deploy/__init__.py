"""From simulation to real Crazyflies: flights as polynomial pieces, checked before they are flown.

Trained policies and force models as C headers are made by `swarm_envs.agents.c_header` and
`swarm_envs.interactions.c_header`.
"""

from swarm_envs.deploy.export import export_flight, report
from swarm_envs.deploy.flight import Flight, flight_along, flight_of, settled
from swarm_envs.deploy.pieces import Pieces, evaluate, read_pieces

__all__ = [
    "Flight",
    "Pieces",
    "evaluate",
    "export_flight",
    "flight_along",
    "flight_of",
    "read_pieces",
    "report",
    "settled",
]
