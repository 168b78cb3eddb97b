"""All flights of a collection to a folder: one file per flight, and a manifest."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from swarm_envs.files import write_json
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.training.collection.config import CollectionConfig, FlightBatch
from swarm_envs.training.collection.flight import fly
from swarm_envs.training.collection.log import FlightLog, resampled
from swarm_envs.training.collection.motion import Motion, RandomWalk, StackedSwaps
from swarm_envs.training.collection.sensors import with_noise
from swarm_envs.training.collection.storage import flight_file, read_log, save_log
from swarm_envs.training.collection.table import Flight, scenario_counts
from swarm_envs.training.provenance import differing, json_ready
from swarm_envs.vehicles import parse_team

MANIFEST = "manifest.json"
"""File that says what the others of a folder hold."""
HELD_OUT_EVERY = 5
"""Of the flights of a team and kind one in so many is for validation."""


def collect(
    config: CollectionConfig,
    out: Path,
    progress: bool = True,
    environment: InteractionModel | None = None,
) -> list[Flight]:
    """Fly what is not yet there, and read everything.

    Writes one file for each flight, and `manifest.json` with the configuration, the force model's
    fingerprint, every flight's length, and how much was flown of each scenario. Killed and called
    again, it goes on with the first batch that lacks a file; the result is the same to the byte.

    Args:
        config: what to fly.
        out: folder of the flights, made if missing.
        progress: show a progress bar.
        environment: the force that blows; None for the one that the configuration names.

    Raises:
        ImportError: flights are to be Parquet, and pyarrow is not installed.
        ValueError: the folder holds flights of another configuration or force model.
    """
    model = load(config.interactions) if environment is None else environment
    believed = None if config.feedforward is None else load(config.feedforward)
    origin: dict[str, object] = {
        "config": json_ready(config.as_dict()),
        "interactions_sha256": model.fingerprint,
        "feedforward_sha256": None if believed is None else believed.fingerprint,
    }
    out.mkdir(parents=True, exist_ok=True)
    begin_manifest(out / MANIFEST, origin)
    batches = config.batches()
    seconds = sum(batch.count for batch in batches) * config.duration_s
    with tqdm(total=round(seconds), disable=not progress, unit="s flown", desc="flights") as bar:
        for batch in batches:
            files = [flight_file(out, name, config.format) for name in batch.names]
            if not all(file.exists() for file in files):
                team = parse_team(batch.team)
                for file, log in zip(files, fly_batch(config, batch, model, believed), strict=True):
                    save_log(file, log, team, config.log_rate, config.label == "imu")
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
    scenarios = {name: count._asdict() for name, count in scenario_counts(flights).items()}
    content = {"log_rate": config.log_rate, "scenarios": scenarios, "flights": entries}
    write_json(out / MANIFEST, origin | content)
    return flights


def was_cut_short(flight: Flight, duration_s: float) -> bool:
    """Whether a flight ended before its time: its team touched something or tumbled."""
    return flight.seconds < duration_s - 0.05


def begin_manifest(path: Path, origin: dict[str, object]) -> None:
    """Note in a file what its folder comes from, or check that it is the same.

    Raises:
        ValueError: it is not.
    """
    if path.exists():
        found = json.loads(path.read_text())
        there = {name: found.get(name) for name in origin}
        differences = differing(there, json.loads(json.dumps(origin)))
        if differences:
            raise ValueError(
                f"{str(path)!r} was made with other options: {differences}; "
                "choose another folder or delete that one"
            )
    else:
        write_json(path, origin)


def flight_generator(config: CollectionConfig, name: str) -> np.random.Generator:
    """Generator of one flight: depends on the seed and on its name alone."""
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return np.random.default_rng([config.seed, key])


def fly_batch(
    config: CollectionConfig,
    batch: FlightBatch,
    model: InteractionModel,
    feedforward: InteractionModel | None = None,
) -> list[FlightLog]:
    """Noisy logs of a batch's flights, at the configuration's rate; see `fly`."""
    rngs = [flight_generator(config, name) for name in batch.names]
    motion, team = make_motion(config, batch, rngs), parse_team(batch.team)
    vehicles = config.errors.draw(team, config.seed, rngs)
    logs = fly(team, motion, model, config.duration_s, feedforward, vehicles, config.pilot)
    return [
        with_noise(resampled(log, config.log_rate), config.noise, rng)
        for log, rng in zip(logs, rngs, strict=True)
    ]


def make_motion(
    config: CollectionConfig, batch: FlightBatch, rngs: list[np.random.Generator]
) -> Motion:
    """The motion of a batch."""
    team, ranges, step = parse_team(batch.team), config.motion, TIME_STEP
    low = batch.kind.startswith("low")
    if batch.kind.endswith("walk"):
        return RandomWalk(team, rngs, ranges, low, config.duration_s, step)
    lowest = ranges.low_lowest_m if low else ranges.lowest_m
    return StackedSwaps(team, rngs, ranges, lowest, config.duration_s, step)


def read_flights(config: CollectionConfig, out: Path) -> list[Flight]:
    """Read the flights of a finished collection.

    Raises:
        FileNotFoundError: a flight is missing.
    """
    return [flight for batch in config.batches() for flight in read_batch(config, out, batch)]


def read_batch(config: CollectionConfig, out: Path, batch: FlightBatch) -> list[Flight]:
    """Read the flights of a batch."""
    team = parse_team(batch.team)
    return [
        Flight(
            name=name,
            team=batch.team,
            log=read_log(flight_file(out, name, config.format), team),
            validation=is_held_out(index, batch.count),
            rate_hz=config.log_rate,
        )
        for index, name in enumerate(batch.names)
    ]


def is_held_out(index: int, count: int) -> bool:
    """Whether flight `index` of `count` is for validation: every fifth, or the last of fewer."""
    return count > 1 and index % HELD_OUT_EVERY == min(HELD_OUT_EVERY, count) - 1
