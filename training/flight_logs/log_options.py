"""Options of how flight logs become rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from swarm_envs.arguments import NOT_NEGATIVE, POSITIVE, Count, Seed, typed_options

__all__ = ["LogOptions"]


@typed_options
@dataclass(frozen=True)
class LogOptions:
    """Options for making rows of flight logs, and for holding rows out."""

    rate_hz: Annotated[float, POSITIVE] = 100.0
    """rate of the common clock of a flight's drones; the slowest drone's own rate where less; of
    tables of rows, their steps per second"""
    keep_every: Count = 3
    """samples per row: neighbouring samples are nearly equal"""
    smoothing_s: Annotated[float, NOT_NEGATIVE] = 0.1
    """width of the Hann window over labels from differentiated velocity; logged accelerations are
    taken as they are, as in the paper"""
    split_seed: Seed = 0
    """seed of the blocks of time that are held out"""
