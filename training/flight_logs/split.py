"""What is held out: whole blocks of time, since neighbouring rows are near copies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.flight_logs.options import LogOptions


def held_out_blocks(lengths: Sequence[int], share: float, seed: int) -> list[BoolArray]:
    """Which blocks of time are held out: of each 1 / share consecutive ones one, drawn at random.

    Args:
        lengths: number of blocks of each flight; a group of blocks runs on into the next flight.
        share: of the blocks to hold out; of a single block nothing.
        seed: of the draw.

    Returns:
        One mask per flight.
    """
    rng, total = np.random.default_rng(seed), sum(lengths)
    chosen = np.zeros(total, dtype=np.bool_)
    size = round(1.0 / share)
    for start in range(0, total if total > 1 else 0, size):
        place = start + int(rng.integers(size if start else min(size, total)))
        chosen[place : place + 1] = True
    return np.split(chosen, np.cumsum(lengths)[:-1])


def block_count(duration_s: float, options: LogOptions) -> int:
    """Number of blocks of a flight."""
    return int(duration_s / options.block_s) + 1


def is_held_out(time: FloatArray, blocks: BoolArray, options: LogOptions) -> BoolArray:
    """Which of the times (R,), s since the flight's start, lie in a held-out block."""
    return blocks[(time / options.block_s).astype(np.int64)]


def is_guarded(time: FloatArray, blocks: BoolArray, options: LogOptions) -> BoolArray:
    """Which of the times (R,), s, lie outside held-out blocks but within the guard gap of one."""
    guarded = np.zeros(len(time), dtype=np.bool_)
    for block in np.flatnonzero(blocks):
        begin = block * options.block_s - options.guard_s
        end = (block + 1) * options.block_s + options.guard_s
        guarded |= (time > begin) & (time < end)
    return guarded & ~is_held_out(time, blocks, options)
