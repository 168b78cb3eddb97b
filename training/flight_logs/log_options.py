"""How flight logs become rows: the options, and the blocks of time that are held out.

Whole blocks are held out, since neighbouring rows are near copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from swarm_envs.arguments import (
    NOT_NEGATIVE,
    POSITIVE,
    POSITIVE_S,
    Count,
    Range,
    Seed,
    typed_options,
)
from swarm_envs.state import BoolArray, FloatArray

__all__ = ["LogOptions", "held_out_blocks"]


@typed_options
@dataclass(frozen=True)
class LogOptions:
    """Options for making rows of flight logs, and for holding rows out."""

    rate_hz: Annotated[float, POSITIVE] = 100.0
    """rate of the common clock of a flight's drones; the slowest drone's own rate where less; of
    tables of rows, their steps per second"""
    keep_every: Count = 3
    """samples per row: neighbouring samples are nearly equal"""
    max_gap_s: Annotated[float, POSITIVE_S] = 0.05
    """longer pauses of a log (and of three of its steps) are gaps, and not filled"""
    smoothing_s: Annotated[float, NOT_NEGATIVE] = 0.1
    """width of the Hann window over labels from differentiated velocity; logged accelerations are
    taken as they are, as in the paper"""
    block_s: Annotated[float, POSITIVE_S] = 5.0
    """length of the blocks of time of which some are held out, all drones of a flight together"""
    validation_share: Annotated[float, Range(0.0, 0.5, above=True)] = 0.2
    """share of the blocks that is held out"""
    guard_s: Annotated[float, NOT_NEGATIVE] = 0.5
    """training rows so near in time to a held-out block of their flight are left out"""
    split_seed: Seed = 0
    """held-out blocks are drawn from it"""
    min_scenario_rows: Annotated[int, Range(0)] = 100
    """scenarios with fewer training rows are left out"""
    min_quiet_rows: Annotated[int, Range(0)] = 30
    """vehicles with fewer training rows aloft, slow and away from wakes are left out, since their
    calibration offset is unknown; 0 keeps all"""


def held_out_blocks(lengths: Sequence[int], share: float, seed: int) -> list[BoolArray]:
    """Which blocks of time are held out: of each 1 / share consecutive ones one, drawn at random.

    Of flights of so many blocks; a group of blocks runs on into the next flight. Of a single block
    nothing is held out. Returns one mask per flight.
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
