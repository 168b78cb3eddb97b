"""Rows of measured interaction force: what logs become, and force models are fitted to.

Order of reading: `rows` (the table and its files), `row_tables` (what is refused), `drone_rows`
(from motion to rows), `hold_out` (which blocks of time are held out), `modelled` (what a force
model says of rows), `calibration` (the constant force that a vehicle seems to feel far from
everything).
"""

from swarm_envs.training.interaction_rows.rows import (
    NO_NEIGHBOR,
    InteractionRows,
    read_rows,
    save_rows,
)

__all__ = ["NO_NEIGHBOR", "InteractionRows", "read_rows", "save_rows"]
