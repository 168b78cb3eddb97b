"""What is collected: teams, motions, sensors, seeds."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from swarm_envs.training.collection.flight import SensorNoise
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.vehicles import parse_team

KINDS = ("walk", "low-walk", "swap", "low-swap")
"""Motions: random walks and stacked swaps, aloft and near the ground."""


@dataclass(frozen=True)
class CollectionConfig:
    """A collection of flights. The same configuration gives the same logs, to the last bit."""

    teams: tuple[str, ...] = ("S", "L", "SS", "SL", "LL", "SSS", "SSL", "SLL", "LLL")
    """who flies together; each drone is in turn the one that feels the force, so that `SL` gives
    the scenarios L2S and S2L"""
    walks: int = 5
    """flights per team that walk at random aloft"""
    low_walks: int = 5
    """flights per team that walk at random near the ground"""
    swaps: int = 5
    """flights per team of two or more that swap places aloft, crossing every few seconds"""
    low_swaps: int = 5
    """flights per team of two or more that swap places near the ground"""
    duration_s: float = 20.0
    """length of a flight, s; a flight ends earlier at its first contact"""
    interactions: str = "learned"
    """force model of the environment: `learned`, `wake`, `none` or a path of weights"""
    motion: MotionRanges = MotionRanges()
    """what the motions are drawn from"""
    noise: SensorNoise = SensorNoise()
    """what sensors add to the logged state; the pilot flies with the true one"""
    seed: int = 0
    """seed of every flight; each has its own generator, so that none depends on another"""

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ValueError: a count, a duration or a team is impossible.
        """
        for team in self.teams:
            parse_team(team)
        if len(set(self.teams)) < len(self.teams):
            raise ValueError(f"teams are {self.teams}, but each may be named once: they name files")
        for name in ("walks", "low_walks", "swaps", "low_swaps", "seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}, but must not be negative")
        if not (math.isfinite(self.duration_s) and self.duration_s >= 1.0):
            raise ValueError(f"duration_s is {self.duration_s}, but must be at least 1 s")

    def batches(self) -> list[FlightBatch]:
        """Flights in the order in which they are flown: those of a batch fly at the same time."""
        counts = dict(zip(KINDS, (self.walks, self.low_walks, self.swaps, self.low_swaps)))
        return [
            FlightBatch(team, kind, count)
            for team in self.teams
            for kind, count in counts.items()
            if count and (len(parse_team(team)) > 1 or kind.endswith("walk"))
        ]

    def as_dict(self) -> dict[str, object]:
        """The configuration as JSON holds it."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class FlightBatch:
    """Flights of one team and kind that fly at the same time, each in its own environment."""

    team: str
    kind: str
    """One of `KINDS`."""
    count: int

    @property
    def names(self) -> tuple[str, ...]:
        """One name per flight, which is also its file's."""
        token = self.team.replace("*", "x")  # file names without wildcards
        return tuple(f"{token}-{self.kind}-{index:03d}" for index in range(self.count))
