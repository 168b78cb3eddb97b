"""How flight logs become rows: options of `swarm_envs.training.flight_logs` and of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class LogOptions:
    """How logs of flights become rows, and which rows of tables are held out."""

    rate_hz: float = 100.0
    """rate of the common clock of a flight's drones; the slowest drone's own rate where less; of
    tables of rows, their steps per second"""
    keep_every: int = 3
    """every so many entries of the clock one row: neighbouring entries are near copies"""
    max_gap_s: float = 0.05
    """longer pauses of a log (and of three of its steps) are gaps, and not filled"""
    smoothing_s: float = 0.1
    """width of the Hann window over labels from differentiated velocity; logged accelerations are
    taken as they are, as in the paper"""
    block_s: float = 5.0
    """length of the blocks of time of which some are held out, all drones of a flight together"""
    validation_share: float = 0.2
    """share of the blocks that is held out"""
    guard_s: float = 0.5
    """training rows so near in time to a held-out block of their flight are left out"""
    split_seed: int = 0
    """held-out blocks are drawn from it"""
    resplit: bool = False
    """draw the held-out blocks of row tables too, though they come with marks; tables without
    marks get drawn blocks in any case"""
    check_units: bool = True
    """refuse row tables whose sizes look like other units"""
    min_scenario_rows: int = 100
    """scenarios with fewer training rows are left out"""

    min_quiet_rows: int = 30
    """vehicles with fewer training rows aloft, slow and away from wakes are left out, since their
    calibration offset is unknown; 0 keeps all"""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ValueError: naming the value and the rule.
        """
        for name in ("rate_hz", "max_gap_s", "block_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}, but must be finite and above 0")
        for name in ("smoothing_s", "guard_s", "split_seed", "min_scenario_rows", "min_quiet_rows"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}, but must be finite and not negative")
        if self.keep_every < 1:
            raise ValueError(f"keep_every is {self.keep_every}, but must be at least 1")
        if not 0.0 < self.validation_share <= 0.5:
            raise ValueError(
                f"validation_share is {self.validation_share}, but must be above 0 and at most 0.5"
            )
