"""Logs of real flights: from plain tables to rows of interaction force.

The format
==========

One flight is one file, CSV (`.csv`: comma, one header line, UTF-8, decimal point) or Parquet
(`.parquet`, which needs `pip install 'swarm-envs[parquet]'`); a folder holds any number of
flights. One line is one drone at one time. The order of the columns is free; the lines of one
drone must be in order of time, and the drones may follow or alternate with one another. Each drone
may have its own times and rate.

=================  =================================================================================
`time`             s; any origin, the same for all drones of the flight
`drone`            name of the physical vehicle, such as `cf7`. The same vehicle has the same name
                   in every file: its calibration offset is estimated over all its flights
`type`             `S`, `L` or `S*` (`swarm_envs.vehicles.VEHICLES`): mass and thrust curve
`x y z`            position, m; world frame, z up, ground at z = 0
`vx vy vz`         velocity, m/s; world frame
`qx qy qz qw`      attitude, body to world, unit quaternion, body x forward, z along thrust
`ax ay az`         m/s^2; world frame, as the accelerometer measures it turned into the world:
                   *with* gravity, so (0, 0, +9.81) in hover. Leave all three columns out and the
                   acceleration is differentiated from the velocity over five points
`pwm1 ... pwm4`    signal of each motor, 0 to 65535
`voltage`          of the battery under load, V
=================  =================================================================================

Other columns are ignored, and the report says which. Numbers must be finite.

A folder that `swarm-envs collect` wrote can be read too.

What is made of it
==================

Label: f_a = m a / g - T R[:, 2] in gram-force (Neural-Swarm2, Sec. VII-B), with psi1 of the type
(Table I) at PWM / 65536 and voltage / 4.2 V for the commanded thrust, which T follows with the
motor rate of eq. (1c). A wrong mass or thrust curve makes a constant offset in it; that belongs to
the vehicle's calibration (`interaction_rows.calibration`), which a fit estimates from lone flight.

All drones of a flight are resampled to one clock. Rows stay if some neighbour is within 0.35 m
laterally in x and y and 1.1 m vertically (of a drone that flies alone: all), z > 0.07 m (S) or
0.085 m (L), |f_z| <= 50 g, and f_z <= 35 g unless z <= 0.25 m: the filter of the authors. One in
five blocks of 5 s is held out. A file that breaks a rule of the format, or copies another, is
refused as a whole; the report (`LogReport`) says why, how many entries each step left out, and what
else lies in the folder.

Commands: `swarm-envs fit --data logs/ --out runs/fit`; to look at logs without a fit,
`python -m swarm_envs.training.flight_logs logs/`.

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
