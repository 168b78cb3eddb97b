"""Blocks of time that are held out: whole ones, since neighboring rows are near copies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.interaction_rows.rows import InteractionRows

__all__ = ["hold_out_blocks"]

BLOCK_S = 5.0
"""Length of a block, all drones of a flight together, s."""
ONE_IN = 5
"""Of so many blocks in a row one is held out."""
GUARD_S = 0.5
"""Training rows so near in time to a held-out block of their flight are left out, s."""


def hold_out_blocks(rows: InteractionRows, rate_hz: float, seed: int) -> InteractionRows:
    """Hold out blocks of time of the flights of a table without marks; one with marks stays.

    Flights of the same scenarios share held-out blocks evenly. A table has `rate_hz` steps a
    second.
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
    """Draw the blocks that are held out, a mask per flight of so many blocks: one of every few.

    A group of blocks runs on into the next flight. Of a single block nothing is held out.
    """
    rng, total = np.random.default_rng(seed), sum(lengths)
    chosen = np.zeros(total, dtype=np.bool_)
    for start in range(0, total if total > 1 else 0, ONE_IN):
        place = start + int(rng.integers(ONE_IN if start else min(ONE_IN, total)))
        chosen[place : place + 1] = True
    return np.split(chosen, np.cumsum(lengths)[:-1])


def near_blocks(time: FloatArray, blocks: BoolArray) -> BoolArray:
    """Which of the times (R,), s since the flight's start, lie within the guard gap of a block."""
    near = np.zeros(len(time), dtype=np.bool_)
    for block in np.flatnonzero(blocks):
        near |= np.abs(time - (block + 0.5) * BLOCK_S) < 0.5 * BLOCK_S + GUARD_S
    return near
