"""Reading of flight logs, or of a table of rows, for a fit.

An invalid log is skipped and reported with its line and the reason.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.training.collection.collect import MANIFEST
from swarm_envs.training.flight_logs.checks import DroneLog, checked_drones
from swarm_envs.training.flight_logs.clock import common_clock, interaction_force_g, kept_entries
from swarm_envs.training.flight_logs.flight_table import SUFFIXES, FlightTable, read_table
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.interaction_rows import InteractionRows, read_rows
from swarm_envs.training.interaction_rows.drone_rows import join_rows, rows_of_drone
from swarm_envs.training.interaction_rows.hold_out import hold_out_blocks
from swarm_envs.training.interaction_rows.row_tables import check_row_table, with_present_types
from swarm_envs.training.provenance import file_sha256

__all__ = ["FileReport", "data_sha256", "read_data"]

TABLE_SUFFIX = ".npz"  # Suffix of a table of rows
DEFAULT = LogOptions()


@dataclass(frozen=True)
class FileReport:
    """The result of reading one file."""

    file: str  # Its name
    rows: int = 0  # Number of its rows
    refused: str = ""  # Error message, which begins with its name; empty for a valid file
    drones: dict[str, str] = field(default_factory=dict)  # Vehicle types by name, of a flight log
    seconds: float = 0.0  # Period that all drones logged, s
    dropped: dict[str, int] = field(default_factory=dict)  # Numbers of dropped entries by reason
    ignored: tuple[str, ...] = ()  # Columns that are not used

    def line(self) -> str:
        """Return the report as a line of text."""
        if self.refused:
            return f"refused {self.refused}"
        reasons = ", ".join(f"{name}: {count}" for name, count in self.dropped.items() if count)
        flown = f" of {self.seconds:.0f} s" if self.drones else ""
        ignored = f"; ignored columns {', '.join(self.ignored)}" if self.ignored else ""
        left_out = f" (dropped: {reasons})" if reasons else ""
        return f"{self.file}: {self.rows} rows{flown}{left_out}{ignored}"


def read_data(
    path: Path, options: LogOptions = DEFAULT, progress: bool = False
) -> tuple[InteractionRows, list[FileReport]]:
    """Read a flight log (`.csv`, `.parquet`), a folder of logs, or a table of rows (`.npz`).

    In a folder of `swarm-envs collect`, `rows.npz` is read. If no row is marked as held out, blocks
    of time are held out. Invalid files of a folder are skipped; the reports give the reasons.

    Raises:
        FileNotFoundError: there is nothing to read.
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: no file is valid, or no row remains; the message gives the reasons.
    """
    files = find_files(path)
    if files[0].suffix.lower() == TABLE_SUFFIX:
        rows, reports = _read_table_of_rows(files[0])
    else:
        rows, reports = _read_logs(files, options, progress)
    return with_present_types(hold_out_blocks(rows, options.rate_hz, options.split_seed)), reports


def find_files(path: Path) -> list[Path]:
    """Return the table of rows, or all files of a folder, sorted by name.

    Raises:
        FileNotFoundError: there is no table and no log.
    """
    if not path.exists():
        raise FileNotFoundError(f"no data at {str(path)!r}; give a log, a folder of logs, or rows")
    if not path.is_dir():
        return [path]
    if (path / MANIFEST).is_file():
        if not (path / "rows.npz").is_file():
            raise FileNotFoundError(
                f"{str(path)!r} has no rows.npz, because the collection is incomplete; run "
                "`swarm-envs collect` again with the same options"
            )
        return [path / "rows.npz"]
    files = sorted(file for file in path.iterdir() if not file.name.startswith("."))
    if not any(file.suffix.lower() in SUFFIXES for file in files):
        raise FileNotFoundError(
            f"{str(path)!r} has no flight log; put {' or '.join(SUFFIXES)} files there, or give "
            f"the path of a table of rows ({TABLE_SUFFIX})"
        )
    return files


def _read_table_of_rows(file: Path) -> tuple[InteractionRows, list[FileReport]]:
    try:
        rows = read_rows(file)
        check_row_table(rows)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error
    return rows, [FileReport(file.name, len(rows))]


def _read_logs(
    files: Sequence[Path], options: LogOptions, progress: bool
) -> tuple[InteractionRows, list[FileReport]]:
    """Read all logs; invalid ones are skipped and reported."""
    parts, reports = list[InteractionRows](), list[FileReport]()
    known = _Known({}, {})
    for number, file in enumerate(tqdm(files, disable=not progress, unit="file")):
        try:
            own, report = _read_log(file, number, known, options)
        except ValueError as error:
            reports.append(FileReport(file.name, refused=str(error)))
        else:
            parts += own
            reports.append(report)
    if not parts:
        raise ValueError("; ".join(report.refused for report in reports))
    if not any(map(len, parts)):
        lines = "; ".join(report.line() for report in reports)
        raise ValueError(f"no row remains ({lines}); fly longer, or closer to each other")
    names = {vehicle.number: name for name, vehicle in known.vehicles.items()}
    return join_rows(parts, names), reports


class _Vehicle(NamedTuple):
    number: int  # Its number in the rows
    token: str  # Token of its type
    file: str  # Name of the first log with it


class _Known(NamedTuple):
    vehicles: dict[str, _Vehicle]  # By name
    flights: dict[str, str]  # Name of the log by the digest of its positions


def _read_log(
    file: Path, number: int, known: _Known, options: LogOptions
) -> tuple[list[InteractionRows], FileReport]:
    """Read the rows of each drone of a flight, and add the flight and its vehicles to `known`."""
    table = read_table(file)
    try:
        drones = checked_drones(table)
        clocked = common_clock(drones, options.rate_hz)
        _refuse_other_types(known.vehicles, drones)
        _refuse_copy(known.flights, table, file.name)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error
    for drone in drones:
        vehicle = _Vehicle(len(known.vehicles), drone.vehicle.token, file.name)
        known.vehicles.setdefault(drone.name, vehicle)
    force, dropped = interaction_force_g(clocked, options.smoothing_s), Counter[str]()
    kinds, parts = [vehicle.interaction_type for vehicle in clocked.team], []
    for i, name in enumerate(clocked.names):
        keep, left_out = kept_entries(clocked, force, i, options.keep_every)
        own, motion = known.vehicles[name].number, (clocked.position, clocked.velocity, force)
        parts.append(
            rows_of_drone(i, kinds, *motion, keep, flight=number, vehicle=own, validation=False)
        )
        dropped.update(left_out)
    report = FileReport(
        file=file.name,
        rows=sum(map(len, parts)),
        drones={drone.name: drone.vehicle.token for drone in drones},
        seconds=round(float(clocked.time[-1]), 3),
        dropped=dict(dropped),
        ignored=table.ignored,
    )
    return parts, report


def _refuse_other_types(vehicles: dict[str, _Vehicle], drones: Sequence[DroneLog]) -> None:
    for drone in drones:
        known = vehicles.get(drone.name)
        if known is not None and known.token != drone.vehicle.token:
            raise ValueError(
                f"drone {drone.name!r} has type {drone.vehicle.token}, but {known.token} in "
                f"{known.file}; give each vehicle a unique name"
            )


def _refuse_copy(flights: dict[str, str], table: FlightTable, name: str) -> None:
    """Raise ValueError if another log has the same positions in single precision."""
    digest = hashlib.sha256(np.float32(table.position).tobytes()).hexdigest()
    first = flights.setdefault(digest, name)
    if first != name:
        raise ValueError(
            f"it is a copy of {first}, so that held-out rows could be trained on; remove one of "
            "them"
        )


def data_sha256(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file, or of names and contents of a folder's files."""
    if not path.is_dir():
        return file_sha256(path)
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        if file.is_file() and not file.name.startswith("."):
            digest.update(f"{file.name}\0{data_sha256(file)}\n".encode())
    return digest.hexdigest()
