"""From a file or a folder of logs to rows, and the report of what became of them.

The same numbers in two files would put training rows among the held-out ones, so copies are
refused. A folder that `swarm-envs collect` wrote is read by its manifest.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs.arguments import typed
from swarm_envs.state import BoolArray
from swarm_envs.training.collection.collect import MANIFEST
from swarm_envs.training.collection.flight import vehicle_names
from swarm_envs.training.collection.storage import flight_file, read_log
from swarm_envs.training.collection.table import (
    ROW_RATE,
    CollectedFlight,
    DroneRows,
    interaction_rows,
    rows_of_drones,
)
from swarm_envs.training.flight_logs.checks import DroneLog, checked_drones
from swarm_envs.training.flight_logs.clock import (
    ClockedFlight,
    common_clock,
    drone_rows,
    interaction_force_g,
)
from swarm_envs.training.flight_logs.log_options import (
    LogOptions,
    block_count,
    held_out_blocks,
    is_guarded,
    is_held_out,
)
from swarm_envs.training.flight_logs.log_report import (
    FileReport,
    JoinedRows,
    LogReport,
    ScenarioReport,
    without_scarce_data,
)
from swarm_envs.training.flight_table import SUFFIXES, read_table
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.vehicles import parse_team

__all__ = ["MANIFEST", "read_logs"]

TABLE_SUFFIX = ".npz"  # How the name of a table of rows ends
DEFAULT = LogOptions()  # The options that hold if none are given


class Found(NamedTuple):
    """What lies at a path; all sorted by name."""

    tables: list[Path]  # Tables of rows
    logs: list[Path]  # Logs of flights
    twice: list[FileReport]
    """Flights that are there in several files, of which none can be preferred."""
    not_read: tuple[str, ...] = ()
    """Names of visible entries that are neither; of folders with a slash."""


def find_data(path: Path) -> Found:
    """Return the tables and logs at a path: itself, or those right in the folder.

    Endings count in capitals too.
    """
    if not path.exists():
        raise FileNotFoundError(
            f"no data at {str(path)!r}; give a file of rows or logs, or a folder"
        )
    if not path.is_dir():
        is_table = path.suffix.lower() == TABLE_SUFFIX
        return Found([path], [], []) if is_table else Found([], [path], [])
    visible = sorted(file for file in path.iterdir() if not file.name.startswith("."))
    kinds = {file: file.suffix.lower() if file.is_file() else "" for file in visible}
    tables = [file for file, kind in kinds.items() if kind == TABLE_SUFFIX]
    logs = [file for file, kind in kinds.items() if kind in SUFFIXES]
    known = {*tables, *logs, path / MANIFEST}
    return Found(
        tables,
        [log for log in logs if len(_same_flight(log, logs)) == 1],
        [
            FileReport(log.name, f"flight {log.stem!r} is there as {names}; keep one of them")
            for log in logs
            if " " in (names := " and as ".join(_same_flight(log, logs)))
        ],
        tuple(f"{f.name}/" if f.is_dir() else f.name for f in visible if f not in known),
    )


def _same_flight(log: Path, logs: list[Path]) -> list[str]:
    return [other.name for other in logs if other.stem == log.stem]


def flight_key(drones: Iterable[DroneLog]) -> str:
    """What a flight and its copies share: motion and signals of its drones.

    Names, origin of time, the order of the drones and digits beyond float32 make no difference.
    """
    keys = (_digest(d.position, d.velocity, d.quaternion, d.pwm) for d in drones)
    return hashlib.sha256("".join(sorted(keys)).encode()).hexdigest()


def table_key(rows: InteractionRows) -> str:
    """What a table and its copies share: inputs by step, without labels and marks."""
    parts = (rows.position, rows.velocity, rows.neighbor, rows.neighbor_type, rows.step)
    inputs = np.concatenate([_single(part).reshape(len(rows), -1) for part in parts], axis=1)
    return _digest(inputs[np.lexsort(inputs.T)])


def refuse_copy(known: dict[str, str], key: str, name: str) -> None:
    """Remember a sound file by its key; refuse one whose key an earlier file has."""
    first = known.setdefault(key, name)
    if first != name:
        raise ValueError(
            f"{name} is a copy of {first}: both have the same numbers, but rows that are held "
            "out may not be trained on; remove one of them"
        )


def _single(values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    return np.asarray(values, dtype=np.float32) + np.float32(0.0)  # no negative zeros


def _digest(*arrays: npt.NDArray[Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(_single(array)).tobytes())
    return digest.hexdigest()


def read_collected(path: Path) -> tuple[InteractionRows, LogReport]:
    """Read the flights of a finished collection; labels, filter and split are the collection's."""
    manifest = json.loads((path / MANIFEST).read_text())
    if "flights" not in manifest:
        raise ValueError(
            f"{str(path / MANIFEST)!r} lists no flights: the collection was not finished; run "
            "`swarm-envs collect` again with the same options"
        )
    flights = [
        CollectedFlight(
            e["name"],
            e["team"],
            read_log(flight_file(path, e["name"])),
            e["validation"],
            manifest["log_rate"],
        )
        for e in manifest["flights"]
    ]
    label = manifest.get("config", {})["label"]
    rows = interaction_rows(flights, label)
    files = [
        FileReport(
            file=flight_file(path, flight.name).name,
            seconds=entry["seconds"],
            rate_hz=flight.rate_hz,
            acceleration="logged" if label == "imu" else label,
            **_counts(flight, int((rows.flight == index).sum())),
        )
        for index, (flight, entry) in enumerate(zip(flights, manifest["flights"], strict=True))
    ]
    held_out = {n: rows.validation[rows.scenario == k] for k, n in enumerate(rows.scenario_names)}
    scenarios = {
        name: ScenarioReport(int((~own).sum()), int(own.sum())) for name, own in held_out.items()
    }
    return rows, LogReport(files, scenarios, {}, len(rows), int(np.sum(rows.validation)))


def _counts(flight: CollectedFlight, rows: int) -> dict[str, Any]:
    """Who flew, the entries of all drones, and why some are no rows."""
    team, every = parse_team(flight.team), round(flight.rate_hz / ROW_RATE)
    entries = len(flight.log.position) * len(team)
    kept = len(flight.log.position[::every]) * len(team)
    reason = "no neighbour in the volume, or force unknown" if len(team) > 1 else "force unknown"
    return {
        "drones": dict(zip(vehicle_names(team), (v.token for v in team), strict=True)),
        "entries": entries,
        "rows": rows,
        "dropped": {"between kept entries": entries - kept, reason: kept - rows},
    }


class _Flight(NamedTuple):
    file: FileReport
    team: str
    rate_hz: float
    rows: list[DroneRows]


@typed
def read_logs(
    path: Path, options: LogOptions = DEFAULT, progress: bool = False
) -> tuple[InteractionRows, LogReport]:
    """Read one flight's log, a folder of them, or a folder that `swarm-envs collect` wrote.

    A file of a folder that breaks a rule is refused, and the others are used; the report says so.

    Raises:
        FileNotFoundError: there is no log at `path`.
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: no file is sound, or none gives a row; the message says why.
    """
    manifest = path / MANIFEST
    made = json.loads(manifest.read_text()).get("config", {}) if manifest.is_file() else None
    if made is not None and made.get("format") != "parquet":  # that is read as real logs
        return read_collected(path)
    found = find_data(path)
    not_read = tuple(sorted([*(file.name for file in found.tables), *found.not_read]))
    if not found.logs and not found.twice:
        raise FileNotFoundError(
            f"{str(path)!r} has no flight log, only {', '.join(not_read[:5]) or 'nothing'}; put "
            "one .csv or .parquet file per flight there"
        )
    joined, refused = join_logs(found.logs, options, progress)
    refused = sorted([*refused, *found.twice], key=lambda file: file.file)
    if joined is None:
        reasons = "; ".join(f"{file.file}: {file.refused}" for file in refused)
        raise ValueError(f"no flight of {str(path)!r} is sound: {reasons}")
    rows, report = without_scarce_data(joined, refused, options)
    return rows, dataclasses.replace(report, not_read=not_read)


def join_logs(
    files: Sequence[Path], options: LogOptions = DEFAULT, progress: bool = False
) -> tuple[JoinedRows | None, list[FileReport]]:
    """Rows of logs, one flight each, numbered in the order of the sound files; and the refused.

    The rows are None if no file is sound.

    Raises:
        ImportError: a log is Parquet, and pyarrow is not installed.
    """
    flights, refused, kinds, known = [], [], dict[str, str](), dict[str, str]()
    for file in tqdm(files, disable=not progress, unit="flight"):
        try:
            flight = _read_flight(file, kinds, known, options)
        except ValueError as error:
            refused.append(FileReport(file.name, str(error)))
        else:
            flights.append(flight)
            kinds |= flight.file.drones
    return _held_out(flights, sorted(kinds), options) if flights else None, refused


def _read_flight(
    file: Path, kinds: dict[str, str], known: dict[str, str], options: LogOptions
) -> _Flight:
    table = read_table(file)
    drones = checked_drones(table)
    for drone in drones:
        token = drone.vehicle.token
        if kinds.get(drone.name, token) != token:
            raise ValueError(
                f"drone {drone.name!r} has the type {token!r} here, but {kinds[drone.name]!r} in "
                "an earlier file; name vehicles apart"
            )
    refuse_copy(known, flight_key(drones), file.name)
    clocked = common_clock(drones, options)
    force = interaction_force_g(clocked, options.smoothing_s)
    rows = [drone_rows(clocked, force, i, options.keep_every) for i in range(len(drones))]
    report = _file_report(file.name, drones, clocked, table.ignored)
    team = "".join(sorted(drone.vehicle.token for drone in drones))
    return _Flight(report, team, clocked.rate_hz, rows)


def _file_report(
    name: str, drones: tuple[DroneLog, ...], clocked: ClockedFlight, ignored: tuple[str, ...]
) -> FileReport:
    logged = max(float(d.time[-1]) for d in drones) - min(float(d.time[0]) for d in drones)
    seconds = float(clocked.time[-1])
    return FileReport(
        file=name,
        drones={drone.name: drone.vehicle.token for drone in drones},
        seconds=round(seconds, 3),
        gap_seconds=round(float((~clocked.known).sum() / clocked.rate_hz), 3),
        uncommon_seconds=round(max(logged - seconds, 0.0), 3),
        rate_hz=round(clocked.rate_hz, 3),
        acceleration="differentiated" if clocked.acceleration is None else "logged",
        ignored_columns=ignored,
        entries=len(clocked.time) * len(drones),
    )


def _held_out(flights: list[_Flight], names: list[str], options: LogOptions) -> JoinedRows:
    """Rows of all flights, blocks of time held out, without those in a guard gap of a block."""
    held_out = []
    for flight, blocks in zip(flights, _blocks(flights, options), strict=True):
        for k, rows in enumerate(flight.rows):
            time = np.asarray(rows.step / flight.rate_hz)
            guarded = is_guarded(time, blocks, options)
            flight.rows[k] = rows.select(~guarded, "guard gap")
            held_out.append(is_held_out(time[~guarded], blocks, options))
    drones = [(number, rows) for number, flight in enumerate(flights) for rows in flight.rows]
    table = rows_of_drones(
        [rows for _, rows in drones],
        slots=max(len(flight.rows) for flight in flights) - 1,
        flight=[number for number, _ in drones],
        vehicle=[names.index(rows.name) for _, rows in drones],
        held_out=np.concatenate(held_out),
        names=dict(enumerate(names)),
    )
    return JoinedRows(table, table.flight, [_with_dropped(flight) for flight in flights])


def _blocks(flights: list[_Flight], options: LogOptions) -> list[BoolArray]:
    """Held-out blocks of every flight; flights of like teams share them out evenly."""
    order = sorted(range(len(flights)), key=lambda k: (flights[k].team, flights[k].file.file))
    lengths = [block_count(flights[k].file.seconds, options) for k in order]
    chosen = held_out_blocks(lengths, options.validation_share, options.split_seed)
    return [blocks for _, blocks in sorted(zip(order, chosen, strict=True), key=lambda e: e[0])]


def _with_dropped(flight: _Flight) -> FileReport:
    dropped = sum((Counter(rows.dropped) for rows in flight.rows), Counter[str]())
    return dataclasses.replace(flight.file, dropped=dict(dropped))
