"""Logs of real flights: from plain tables to rows of interaction force.

The format, what is made of it and what is refused: docs/flight-logs.md. Commands: `swarm-envs fit
--data logs/ --out runs/fit`; to look at logs without a fit, `python -m
swarm_envs.training.flight_logs logs/`.

Order of reading: `log_options`, `swarm_envs.training.flight_table` (the file), `checks` (its
rules), `clock` (one clock for all drones, the force, which entries stay), `read` (all),
`log_report`, `fit_data` (logs among tables of rows, as a fit takes them).
"""

from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.log_report import LogReport
from swarm_envs.training.flight_logs.read import read_logs
from swarm_envs.training.flight_table import FlightTable, read_table
from swarm_envs.training.flight_table import write_flight_table as write_table

__all__ = ["FlightTable", "LogOptions", "LogReport", "read_logs", "read_table", "write_table"]
