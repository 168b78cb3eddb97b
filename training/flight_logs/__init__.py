"""Own flights in: from flight logs and tables of rows to the rows of a fit.

The columns of a log and what is made of it: docs/flight-logs.md. Command: `swarm-envs fit --data
logs/ --out runs/fit`.

Order of reading: `flight_table` (the file and its columns), `checks` (rules that columns keep
together), `clock` (one clock for all drones, the force, which entries stay), `read` (all).
"""

from swarm_envs.training.flight_logs.flight_table import FlightTable, read_table
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import read_data

__all__ = ["FlightTable", "LogOptions", "read_data", "read_table"]
