"""Import of flight logs and tables of rows for the fit of force models.

docs/flight-logs.md describes the columns of a log and their use. Command: `swarm-envs fit --data
logs/ --out runs/fit`.

Order of reading: `flight_table` (the file and its columns), `checks` (consistency of columns),
`clock` (resampling, the force, the filter of entries), `read` (all).
"""

from swarm_envs.training.flight_logs.flight_table import FlightTable, read_table
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.read import read_data

__all__ = ["FlightTable", "LogOptions", "read_data", "read_table"]
