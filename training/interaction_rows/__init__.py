"""Rows of measured interaction force, to which force models are fitted.

Order of reading: `rows` (the table and its files), `row_tables` (checks), `drone_rows` (conversion
of motion to rows), `hold_out` (held-out blocks of time), `modelled` (predictions of force models),
`calibration` (offsets of the labels).
"""

from swarm_envs.training.interaction_rows.rows import (
    NO_NEIGHBOR,
    InteractionRows,
    read_rows,
    save_rows,
)

__all__ = ["NO_NEIGHBOR", "InteractionRows", "read_rows", "save_rows"]
