"""From a file or a folder of logs to rows, and the report of what became of them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.collection.table import TYPES
from swarm_envs.training.flight_logs.checks import check_table
from swarm_envs.training.flight_logs.clock import ClockedFlight, common_clock
from swarm_envs.training.flight_logs.collected import is_collection, read_collected
from swarm_envs.training.flight_logs.copies import flight_key, refuse_copy
from swarm_envs.training.flight_logs.drone import DroneLog
from swarm_envs.training.flight_logs.filters import DroneRows, drone_rows, padded
from swarm_envs.training.flight_logs.folder import find_data
from swarm_envs.training.flight_logs.labels import interaction_force_g
from swarm_envs.training.flight_logs.options import LogOptions
from swarm_envs.training.flight_logs.report import (
    Calibration,
    FileReport,
    LogReport,
    ScenarioReport,
    calibrate,
    scenario_report,
    uncalibrated,
)
from swarm_envs.training.flight_logs.split import (
    block_count,
    held_out_blocks,
    is_guarded,
    is_held_out,
)
from swarm_envs.training.flight_table import read_table
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.join import with_present_types

DEFAULT = LogOptions()
"""The options that hold if none are given."""


class _Flight(NamedTuple):
    file: FileReport
    team: str
    rate_hz: float
    rows: list[DroneRows]


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
    if is_collection(path):
        return read_collected(path)
    found = find_data(path)
    not_read = tuple(sorted([*(file.name for file in found.tables), *found.not_read]))
    if not found.logs and not found.twice:
        raise FileNotFoundError(
            f"{str(path)!r} has no flight log, only {', '.join(not_read[:5]) or 'nothing'}; put "
            "one .csv or .parquet file per flight there"
        )
    rows, report = read_flights(found.logs, options, progress)
    files = sorted([*report.files, *found.twice], key=lambda file: file.file)
    report = dataclasses.replace(report, files=files, not_read=not_read)
    if rows is None:
        reasons = "; ".join(f"{file.file}: {file.refused}" for file in report.files)
        raise ValueError(f"no flight of {str(path)!r} is sound: {reasons}")
    return rows, report


def read_flights(
    files: Sequence[Path], options: LogOptions = DEFAULT, progress: bool = False
) -> tuple[InteractionRows | None, LogReport]:
    """Read logs, one flight each; flights are numbered in the order of the sound files.

    Returns:
        The rows, None if no file is sound; and what became of every file.

    Raises:
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: the sound files give no row.
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
    if not flights:
        return None, LogReport(refused, {}, {}, 0, 0)
    return _assemble(flights, refused, sorted(kinds), options)


def _read_flight(
    file: Path, kinds: dict[str, str], known: dict[str, str], options: LogOptions
) -> _Flight:
    table = read_table(file)
    drones = check_table(table)
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


def _assemble(
    flights: list[_Flight], refused: list[FileReport], names: list[str], options: LogOptions
) -> tuple[InteractionRows, LogReport]:
    vehicles = {name: index for index, name in enumerate(names)}
    flights = _guarded(flights, blocks := _blocks(flights, options), options)
    unknown = _uncalibrated(flights, blocks, vehicles, options)
    for flight in flights:
        flight.rows[:] = [
            rows.select(np.full(len(rows.step), rows.name not in unknown), "vehicle not calibrated")
            for rows in flight.rows
        ]
    scenarios = _scenarios(flights, blocks, options)
    kept = [name for name, scenario in scenarios.items() if scenario.refused is None]
    for flight in flights:
        flight.rows[:] = [
            rows.select(np.full(len(rows.step), rows.scenario in kept), "scenario too small")
            for rows in flight.rows
        ]
    files = [_filled(flight) for flight in flights]
    if not any(file.rows for file in files):
        dropped = sum((Counter(file.dropped) for file in files), Counter[str]())
        reasons = ", ".join(f"{reason}: {count}" for reason, count in dropped.items())
        raise ValueError(
            f"{len(flights)} flights give no row (entries left out: {reasons}); fly longer, or "
            "nearer to each other"
        )
    table = _rows(flights, blocks, vehicles, kept, options)
    files = sorted([*files, *refused], key=lambda file: file.file)
    calibration = calibrate(table, vehicles) | unknown
    held_out = int(table.validation.sum())
    return table, LogReport(files, scenarios, calibration, len(table), held_out)


def _seconds(flight: _Flight, rows: DroneRows) -> FloatArray:
    return np.asarray(rows.step / flight.rate_hz)


def _blocks(flights: list[_Flight], options: LogOptions) -> list[BoolArray]:
    """Held-out blocks of every flight; flights of like teams share them out evenly."""
    order = sorted(range(len(flights)), key=lambda k: (flights[k].team, flights[k].file.file))
    lengths = [block_count(flights[k].file.seconds, options) for k in order]
    chosen = held_out_blocks(lengths, options.validation_share, options.split_seed)
    return [blocks for _, blocks in sorted(zip(order, chosen, strict=True), key=lambda e: e[0])]


def _guarded(flights: list[_Flight], blocks: list[BoolArray], options: LogOptions) -> list[_Flight]:
    result = []
    for flight, own in zip(flights, blocks, strict=True):
        rows = [
            r.select(~is_guarded(_seconds(flight, r), own, options), "guard gap")
            for r in flight.rows
        ]
        result.append(flight._replace(rows=rows))
    return result


def _uncalibrated(
    flights: list[_Flight], blocks: list[BoolArray], vehicles: dict[str, int], options: LogOptions
) -> dict[str, Calibration]:
    """Vehicles with too few quiet rows, by name."""
    scenarios = sorted({rows.scenario for flight in flights for rows in flight.rows})
    if not any(len(rows.step) for flight in flights for rows in flight.rows):
        return {}
    return uncalibrated(_rows(flights, blocks, vehicles, scenarios, options), vehicles, options)


def _scenarios(
    flights: list[_Flight], blocks: list[BoolArray], options: LogOptions
) -> dict[str, ScenarioReport]:
    training, validation = Counter[str](), Counter[str]()
    for flight, own in zip(flights, blocks, strict=True):
        for rows in flight.rows:
            held_out = is_held_out(_seconds(flight, rows), own, options)
            training[rows.scenario] += int((~held_out).sum())
            validation[rows.scenario] += int(held_out.sum())
    return {
        name: scenario_report(training[name], validation[name], options)
        for name in sorted(training)
    }


def _filled(flight: _Flight) -> FileReport:
    dropped = sum((Counter(rows.dropped) for rows in flight.rows), Counter[str]())
    count = sum(len(rows.step) for rows in flight.rows)
    return dataclasses.replace(flight.file, rows=count, dropped=dict(dropped))


def _rows(
    flights: list[_Flight],
    blocks: list[BoolArray],
    vehicles: dict[str, int],
    scenarios: list[str],
    options: LogOptions,
) -> InteractionRows:
    slots = max(len(flight.rows) for flight in flights) - 1
    tables = []
    for number, (flight, own) in enumerate(zip(flights, blocks, strict=True)):
        for rows in flight.rows:
            if not len(rows.step):
                continue
            neighbor, neighbor_type = padded(rows, slots)
            constants = {
                "ego_type": rows.ego_type,
                "flight": number,
                "vehicle": vehicles[rows.name],
                "scenario": scenarios.index(rows.scenario),
            }
            tables.append(
                {
                    "position": rows.position,
                    "velocity": rows.velocity,
                    "neighbor": neighbor,
                    "neighbor_type": neighbor_type,
                    "force_g": rows.force_g,
                    "step": rows.step,
                    "validation": is_held_out(_seconds(flight, rows), own, options),
                    **{k: np.full(len(rows.step), v) for k, v in constants.items()},
                }
            )
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    named = {number: name for name, number in vehicles.items()}
    rows_of_all = InteractionRows(
        TYPES, scenario_names=tuple(scenarios), vehicle_names=named, **columns
    )
    return with_present_types(rows_of_all)
