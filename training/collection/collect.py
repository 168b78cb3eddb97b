"""All flights of a collection to a folder: one file per flight, and a manifest."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from swarm_envs.files import write_json, written_whole
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.training.collection.config import CollectionConfig, FlightBatch
from swarm_envs.training.collection.flight import LOG_RATE, FlightLog, fly, with_noise
from swarm_envs.training.collection.motion import Motion, RandomWalk, StackedSwaps
from swarm_envs.training.collection.table import Flight
from swarm_envs.training.force_model.files import json_ready
from swarm_envs.vehicles import parse_team

MANIFEST = "manifest.json"
HELD_OUT_EVERY = 5
"""Of the flights of a team and kind one in so many is for validation."""


def collect(config: CollectionConfig, out: Path, progress: bool = True) -> list[Flight]:
    """Fly what is not yet there, and read everything.

    Writes `<flight>.npz` for each flight, and `manifest.json` with the configuration, the force
    model's fingerprint and every flight's length. Killed and called again, it goes on with the
    first batch that lacks a file; the result is the same.

    Args:
        config: what to fly.
        out: folder of the flights, made if missing.
        progress: show a progress bar.

    Raises:
        ValueError: the folder holds flights of another configuration or force model.
    """
    model = load(config.interactions)
    origin = {"config": json_ready(config.as_dict()), "interactions_sha256": fingerprint(model)}
    out.mkdir(parents=True, exist_ok=True)
    begin_manifest(out, origin)
    batches = config.batches()
    seconds = sum(batch.count for batch in batches) * config.duration_s
    with tqdm(total=round(seconds), disable=not progress, unit="s flown") as bar:
        for batch in batches:
            if not all(flight_file(out, name).exists() for name in batch.names):
                for name, log in zip(batch.names, fly_batch(config, batch, model), strict=True):
                    save_log(flight_file(out, name), log)
            bar.update(round(batch.count * config.duration_s))
    flights = [flight for batch in batches for flight in read_batch(out, batch)]
    entries = [
        {
            "name": flight.name,
            "team": flight.team,
            "seconds": round(len(flight.log.position) / LOG_RATE, 3),
            "validation": flight.validation,
        }
        for flight in flights
    ]
    write_json(out / MANIFEST, {**origin, "log_rate": LOG_RATE, "flights": entries})
    return flights


def begin_manifest(out: Path, origin: dict[str, object]) -> None:
    """Note in the folder what its flights come from, or check that it is the same.

    Raises:
        ValueError: it is not.
    """
    path = out / MANIFEST
    if path.exists():
        found = json.loads(path.read_text())
        for name, value in origin.items():
            if found.get(name) != json.loads(json.dumps(value)):
                raise ValueError(
                    f"{str(path)!r} has the {name} {found.get(name)}, but this collection has "
                    f"{value}; choose another folder or delete that one"
                )
    else:
        write_json(path, origin)


def fingerprint(model: InteractionModel) -> str:
    """SHA-256 of a force model's numbers: says exactly what blew."""
    digest = hashlib.sha256(model.name.encode() if model.name in ("none", "wake") else b"")
    for value in model.field:
        digest.update(np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def flight_file(out: Path, name: str) -> Path:
    """The file of a flight."""
    return out / f"{name}.npz"


def flight_generator(config: CollectionConfig, name: str) -> np.random.Generator:
    """Generator of one flight: depends on the seed and on its name alone."""
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return np.random.default_rng([config.seed, key])


def fly_batch(
    config: CollectionConfig, batch: FlightBatch, model: InteractionModel
) -> list[FlightLog]:
    """Noisy logs of a batch's flights; see `fly`."""
    rngs = [flight_generator(config, name) for name in batch.names]
    motion = make_motion(config, batch, rngs)
    logs = fly(parse_team(batch.team), motion, model, config.duration_s)
    return [with_noise(log, config.noise, rng) for log, rng in zip(logs, rngs, strict=True)]


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


def save_log(path: Path, log: FlightLog) -> None:
    """Write a log as npz without pickle, in single precision, atomically."""
    arrays = {name: array.astype(np.float32) for name, array in log._asdict().items()}
    with written_whole(path) as partial:
        np.savez(partial, allow_pickle=False, **arrays)


def read_flights(config: CollectionConfig, out: Path) -> list[Flight]:
    """Read the flights of a finished collection.

    Raises:
        FileNotFoundError: a flight is missing.
    """
    return [flight for batch in config.batches() for flight in read_batch(out, batch)]


def read_batch(out: Path, batch: FlightBatch) -> list[Flight]:
    """Read the flights of a batch."""
    return [
        Flight(name, batch.team, read_log(flight_file(out, name)), is_held_out(index, batch.count))
        for index, name in enumerate(batch.names)
    ]


def is_held_out(index: int, count: int) -> bool:
    """Whether flight `index` of `count` is for validation: every fifth, or the last of fewer."""
    return count > 1 and index % HELD_OUT_EVERY == min(HELD_OUT_EVERY, count) - 1


def read_log(path: Path) -> FlightLog:
    """Read a file that `save_log` wrote.

    Raises:
        FileNotFoundError: there is none.
    """
    with np.load(path, allow_pickle=False) as file:
        return FlightLog(*(file[name].astype(np.float64) for name in FlightLog._fields))
