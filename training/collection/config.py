"""What is collected: teams, motions, sensors, seeds."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from swarm_envs.arguments import typed
from swarm_envs.errors import check_name
from swarm_envs.training.collection.fleet import CalibrationErrors
from swarm_envs.training.collection.flight import PILOTS
from swarm_envs.training.collection.labels import Label
from swarm_envs.training.collection.log import LOG_RATE
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.training.collection.sensors import SensorNoise
from swarm_envs.training.collection.storage import Format
from swarm_envs.vehicles import parse_team

RATES = (100, LOG_RATE)
"""Log entries per second that can be had."""

KINDS = ("walk", "low-walk", "swap", "low-swap")
"""Motions: random walks and stacked swaps, aloft and near the ground."""


@typed
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
    feedforward: Path | None = None
    """weights of the force model that the pilot compensates for; None for no compensation"""
    pilot: Literal["soft", "mid", "stiff", "firm"] = "firm"
    """position gains of the pilot: the controller's presets, or `firm`, stiffer than flights need,
    to hold place in wakes that it does not know"""
    log_rate: Literal[100, 120] = 120
    """log entries per second: as flown, or resampled to 100"""
    label: Label = "differentiated"
    """where the acceleration of the force's label comes from: velocities differentiated over five
    points, or the accelerometer"""
    format: Format = "npz"
    """files of flights: `npz`, or `parquet` in the format of real logs (docs/flight-logs.md), with
    the accelerations if they are to give the label"""
    motion: MotionRanges = MotionRanges()
    """what the motions are drawn from"""
    noise: SensorNoise = SensorNoise()
    """what sensors add to the logged state; the pilot flies with the true one"""
    errors: CalibrationErrors = CalibrationErrors()
    """by how much vehicles differ from their type; none by default"""
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
        if self.log_rate not in RATES:
            raise ValueError(f"log_rate is {self.log_rate}, but must be 100 or {LOG_RATE}")
        check_name("pilot", self.pilot, PILOTS)
        check_name("label", self.label, ("differentiated", "imu"))
        check_name("format", self.format, ("npz", "parquet"))
        if not self.batches():
            raise ValueError(
                f"teams {self.teams} and the counts walks {self.walks}, low_walks "
                f"{self.low_walks}, swaps {self.swaps}, low_swaps {self.low_swaps} give no flight "
                "(a lone drone does not swap); name a team, and at least one flight of it"
            )

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
    """Who flies together."""
    kind: str
    """One of `KINDS`."""
    count: int
    """Number of flights."""

    @property
    def names(self) -> tuple[str, ...]:
        """One name per flight, which is also its file's."""
        token = self.team.replace("*", "x")  # file names without wildcards
        return tuple(f"{token}-{self.kind}-{index:03d}" for index in range(self.count))
