"""Options of how flight logs become rows."""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.errors import check_integer, check_number

__all__ = ["LogOptions"]


@dataclass(frozen=True)
class LogOptions:
    """Options for making rows of flight logs, and for holding rows out."""

    rate_hz: float = 100.0
    """rate of the common clock of a flight's drones; the slowest drone's own rate where less; of
    tables of rows, their steps per second"""
    keep_every: int = 3
    """samples per row: neighbouring samples are nearly equal"""
    smoothing_s: float = 0.1
    """width of the Hann window over labels from differentiated velocity; logged accelerations are
    taken as they are, as in the paper"""
    split_seed: int = 0
    """seed of the blocks of time that are held out"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("rate_hz", self.rate_hz, above=0.0, unit="Hz")
        check_integer("keep_every", self.keep_every, at_least=1)
        check_number("smoothing_s", self.smoothing_s, at_least=0.0, unit="s")
        check_integer("split_seed", self.split_seed, at_least=0)
