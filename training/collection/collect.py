"""The configuration of a collection, and its flights: one file each in a folder, and a manifest."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs.errors import check_integer, check_name, check_number, check_type
from swarm_envs.files import write_json
from swarm_envs.hall import Hall
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.training.collection.flight import fly_motion
from swarm_envs.training.collection.log import (
    LOG_RATE,
    FlightLog,
    Label,
    SensorNoise,
    read_log,
    save_log,
    with_noise,
)
from swarm_envs.training.collection.motion import MotionRanges, RandomWalk, StackedSwaps, TeamMotion
from swarm_envs.training.collection.table import CollectedFlight
from swarm_envs.training.provenance import begin_manifest, json_ready
from swarm_envs.vehicles import parse_team

__all__ = ["MANIFEST", "CollectionConfig", "collect", "was_cut_short"]

KINDS = ("walk", "low-walk", "swap", "low-swap")
"""Motions: random walks and stacked swaps, aloft and near the ground."""


@dataclass(frozen=True)
class CollectionConfig:
    """A collection of flights. The same configuration gives bitwise identical logs."""

    teams: tuple[str, ...] = ("S", "L", "SS", "SL", "LL", "SSS", "SSL", "SLL", "LLL")
    """Vehicle types of each team. The force on every drone is labeled: `SL` gives the scenarios
    L2S (a large drone acts on a small one) and S2L (a small drone acts on a large one)."""
    walks: int = 5
    """Number of random walks per team aloft."""
    low_walks: int = 5
    """Number of random walks per team near the ground."""
    swaps: int = 5
    """Number of stacked swaps aloft per team of two or more; drones cross every few seconds."""
    low_swaps: int = 5
    """Number of stacked swaps near the ground per team of two or more."""
    duration_s: float = 20.0
    """Duration of a flight, s. A flight ends at its first contact."""
    interactions: str = "learned"
    """Force model of the environment: `learned`, `wake`, `none` or a weights file."""
    world: Literal["ideal", "hall"] = "ideal"
    """World: in `hall`, random forces act, and the controller and the log use an estimate of the
    state; see docs/hall.md."""
    feedforward: Path | None = None
    """Weights file of the force model that the controller compensates. If None, no compensation."""
    pilot: Literal["soft", "mid", "stiff", "firm"] = "firm"
    """Position gains of the controller: one of its presets, or `firm`, whose gains are high enough
    to hold the position in the wakes of other drones."""
    label: Label = "differentiated"
    """Acceleration in the force labels: velocities `differentiated` over five points, or that of
    the accelerometer (`imu`)."""
    motion: tyro.conf.Suppress[MotionRanges] = MotionRanges()
    """Ranges from which the motions are drawn."""
    noise: tyro.conf.Suppress[SensorNoise] = SensorNoise()
    """Sensor noise of the logged state; the controller uses the state without it."""
    seed: int = 0
    """Random seed of the flights; each has its own generator and depends on no other."""

    def __post_init__(self) -> None:
        for name in ("walks", "low_walks", "swaps", "low_swaps", "seed"):
            check_integer(name, getattr(self, name), at_least=0)
        check_number("duration_s", self.duration_s, at_least=1.0, unit="s")
        check_name("world", self.world, ("ideal", "hall"))
        check_name("pilot", self.pilot, ("soft", "mid", "stiff", "firm"))
        check_name("label", self.label, get_args(Label))
        check_type("interactions", self.interactions, str)
        check_type("motion", self.motion, MotionRanges)
        check_type("noise", self.noise, SensorNoise)
        for team in self.teams:
            parse_team(team)
        if len(set(self.teams)) < len(self.teams):
            raise ValueError(
                f"teams are {self.teams}, but each must be given once, as they name the files"
            )
        if not self.batches():
            raise ValueError(
                f"teams {self.teams} and the counts walks {self.walks}, low_walks "
                f"{self.low_walks}, swaps {self.swaps}, low_swaps {self.low_swaps} give no flight "
                "(a lone drone does not swap); name a team, and at least one flight of it"
            )

    def batches(self) -> list[FlightBatch]:
        """Return the batches of flights in order; the flights of a batch are simulated together."""
        counts = dict(zip(KINDS, (self.walks, self.low_walks, self.swaps, self.low_swaps)))
        return [
            FlightBatch(team, kind, count)
            for team in self.teams
            for kind, count in counts.items()
            if count and (len(parse_team(team)) > 1 or kind.endswith("walk"))
        ]


@dataclass(frozen=True)
class FlightBatch:
    """Flights of one team and kind that are simulated together, each in its own environment."""

    team: str  # Vehicle types of the team
    kind: str  # One of `KINDS`
    count: int  # Number of flights

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the flights and of their files."""
        token = self.team.replace("*", "x")  # no wildcards in names of files
        return tuple(f"{token}-{self.kind}-{index:03d}" for index in range(self.count))


MANIFEST = "manifest.json"
"""File that describes the other files of a folder."""
HELD_OUT_EVERY = 5  # One in this many flights of a team and kind is held out for validation


def collect(config: CollectionConfig, out: Path, progress: bool = True) -> list[CollectedFlight]:
    """Simulate the flights whose files are missing, and read all flights.

    Writes one file for each flight, and `manifest.json` with the configuration, the force model's
    fingerprint and every flight's duration. An interrupted collection resumes with the first
    missing file; the result is identical.

    Raises:
        ValueError: the folder has flights of another configuration or force model.
    """
    model = load(config.interactions)
    compensated = None if config.feedforward is None else load(config.feedforward)
    origin: dict[str, object] = {
        "config": json_ready(config),
        "interactions_sha256": model.fingerprint,
        "feedforward_sha256": None if compensated is None else compensated.fingerprint,
    }
    out.mkdir(parents=True, exist_ok=True)
    begin_manifest(out / MANIFEST, origin)
    batches = config.batches()
    seconds = sum(batch.count for batch in batches) * config.duration_s
    with tqdm(
        total=round(seconds), disable=not progress, unit="s", desc="flights, simulated time"
    ) as bar:
        for batch in batches:
            files = [out / f"{name}.npz" for name in batch.names]
            if not all(file.exists() for file in files):
                logs = fly_flights(config, batch, model, compensated)
                for file, log in zip(files, logs, strict=True):
                    save_log(file, log)
            bar.update(round(batch.count * config.duration_s))
    flights = [flight for batch in batches for flight in read_batch(config, out, batch)]
    entries = [
        {
            "name": flight.name,
            "team": flight.team,
            "seconds": round(flight.seconds, 3),
            "cut_short": was_cut_short(flight, config.duration_s),
            "validation": flight.validation,
        }
        for flight in flights
    ]
    write_json(out / MANIFEST, origin | {"log_rate": LOG_RATE, "flights": entries})
    return flights


def was_cut_short(flight: CollectedFlight, duration_s: float) -> bool:
    """Return True if a flight ended early, by a contact or because a drone tumbled."""
    return flight.seconds < duration_s - 0.05


def flight_generator(config: CollectionConfig, name: str) -> np.random.Generator:
    """Return the generator of a flight, which depends only on the seed and the flight's name."""
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return np.random.default_rng([config.seed, key])


def fly_flights(
    config: CollectionConfig,
    batch: FlightBatch,
    model: InteractionModel,
    feedforward: InteractionModel | None = None,
) -> list[FlightLog]:
    """Simulate the flights of a batch and return their noisy logs; see `fly_motion`."""
    rngs = [flight_generator(config, name) for name in batch.names]
    motion, team = make_motion(config, batch, rngs), parse_team(batch.team)
    hall, duration = Hall.of(config.world), config.duration_s
    logs = fly_motion(team, motion, model, duration, feedforward, config.pilot, hall, rngs)
    return [with_noise(log, config.noise, rng) for log, rng in zip(logs, rngs, strict=True)]


def make_motion(
    config: CollectionConfig, batch: FlightBatch, rngs: list[np.random.Generator]
) -> TeamMotion:
    """Return the motion of a batch."""
    team, ranges = parse_team(batch.team), config.motion
    low = batch.kind.startswith("low")
    if batch.kind.endswith("walk"):
        return RandomWalk(team, rngs, ranges, low, config.duration_s)
    lowest = ranges.low_lowest_m if low else ranges.lowest_m
    return StackedSwaps(team, rngs, ranges, lowest, config.duration_s)


def read_batch(config: CollectionConfig, out: Path, batch: FlightBatch) -> list[CollectedFlight]:
    """Read the flights of a batch."""
    return [
        CollectedFlight(
            name=name,
            team=batch.team,
            log=read_log(out / f"{name}.npz"),
            validation=_is_held_out(config, batch, index),
        )
        for index, name in enumerate(batch.names)
    ]


def _is_held_out(config: CollectionConfig, batch: FlightBatch, index: int) -> bool:
    """Return True if a flight is held out: every fifth of a batch, or the last of a smaller one.

    If all batches have a single flight, that of the last batch is held out.
    """
    batches = config.batches()
    if all(each.count == 1 for each in batches):
        return batch == batches[-1] and len(batches) > 1
    fifth = min(HELD_OUT_EVERY, batch.count) - 1
    return batch.count > 1 and index % HELD_OUT_EVERY == fifth
