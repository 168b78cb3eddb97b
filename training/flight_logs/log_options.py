"""Options of the conversion of flight logs to rows."""

from __future__ import annotations

from dataclasses import dataclass

from swarm_envs.errors import check_integer, check_number

__all__ = ["LogOptions"]


@dataclass(frozen=True)
class LogOptions:
    """Options of the conversion of flight logs to rows, and of the rows that are held out."""

    rate_hz: float = 100.0
    """Rate to which the logs of all drones of a flight are resampled, Hz, or that of the slowest
    log if it is lower. For tables of rows, the rate of their steps, Hz."""
    keep_every: int = 3
    """Keep one of this many samples as a row, as consecutive samples are nearly equal."""
    smoothing_s: float = 0.1
    """Width of the Hann window that smooths labels from differentiated velocities, s. Logged
    accelerations are not smoothed, as in the paper."""
    split_seed: int = 0
    """Random seed of the blocks of time that are held out for validation."""

    def __post_init__(self) -> None:
        """Raise ValueError if an option has an invalid value."""
        check_number("rate_hz", self.rate_hz, above=0.0, unit="Hz")
        check_integer("keep_every", self.keep_every, at_least=1)
        check_number("smoothing_s", self.smoothing_s, at_least=0.0, unit="s")
        check_integer("split_seed", self.split_seed, at_least=0)
