"""Held-out blocks of time: whole blocks, because consecutive rows are nearly equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.interaction_rows.rows import InteractionRows

__all__ = ["hold_out_blocks"]

BLOCK_S = 5.0
"""Duration of a block, for all drones of a flight together, s."""
ONE_IN = 5
"""One in this many consecutive blocks is held out."""
GUARD_S = 0.5
"""Time around a held-out block in which training rows of its flight are dropped, s."""


def hold_out_blocks(rows: InteractionRows, rate_hz: float, seed: int) -> InteractionRows:
    """Hold out blocks of time of a table, unless some of its rows already are held out.

    Held-out blocks are distributed evenly over flights of the same scenarios. The table has
    `rate_hz` steps per second.
    """
    if rows.validation.any():
        return rows
    held_out, guarded = rows.validation.copy(), np.zeros(len(rows), dtype=np.bool_)
    flights = [np.flatnonzero(rows.flight == flight) for flight in np.unique(rows.flight)]
    flights.sort(key=lambda own: tuple(np.unique(rows.scenario[own])))
    times = [(rows.step[own] - rows.step[own].min()) / rate_hz for own in flights]
    blocks = draw_blocks([int(time.max() / BLOCK_S) + 1 for time in times], seed)
    for own, time, block in zip(flights, times, blocks, strict=True):
        held_out[own] = block[(time / BLOCK_S).astype(np.int64)]
        guarded[own] = near_blocks(time, block) & ~held_out[own]
    return replace(rows, validation=held_out).select(~guarded)


def draw_blocks(lengths: Sequence[int], seed: int) -> list[BoolArray]:
    """Return the masks of held-out blocks of flights with these numbers of blocks.

    One of `ONE_IN` consecutive blocks is held out, counted across flights; a single block is not.
    """
    rng, total = np.random.default_rng(seed), sum(lengths)
    chosen = np.zeros(total, dtype=np.bool_)
    for start in range(0, total if total > 1 else 0, ONE_IN):
        place = start + int(rng.integers(ONE_IN if start else min(ONE_IN, total)))
        chosen[place : place + 1] = True
    return np.split(chosen, np.cumsum(lengths)[:-1])


def near_blocks(time: FloatArray, blocks: BoolArray) -> BoolArray:
    """Return True for times (R,), s since the flight's start, near a held-out block."""
    near = np.zeros(len(time), dtype=np.bool_)
    for block in np.flatnonzero(blocks):
        near |= np.abs(time - (block + 0.5) * BLOCK_S) < 0.5 * BLOCK_S + GUARD_S
    return near
