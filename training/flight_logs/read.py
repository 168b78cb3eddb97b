"""From files to the rows of a fit: flight logs, tables of rows, or a folder of both.

What is sound is joined; a file that breaks a rule costs that file alone. The same numbers in two
files would put training rows among the held-out ones, so copies are refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs.state import FloatArray
from swarm_envs.training.collection.collect import MANIFEST
from swarm_envs.training.collection.table import rows_of_drones
from swarm_envs.training.flight_logs.checks import DroneLog, checked_drones
from swarm_envs.training.flight_logs.clock import (
    ClockedFlight,
    common_clock,
    drone_rows,
    interaction_force_g,
)
from swarm_envs.training.flight_logs.flight_table import SUFFIXES, read_table
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
    without_scarce_data,
)
from swarm_envs.training.interaction_rows import InteractionRows, read_rows
from swarm_envs.training.interaction_rows.row_tables import check_row_table, join_rows
from swarm_envs.training.provenance import file_sha256

__all__ = ["data_sha256", "read_data"]

TABLE_SUFFIX = ".npz"  # How the name of a table of rows ends
DEFAULT = LogOptions()  # The options that hold if none are given


def read_data(
    path: Path,
    options: LogOptions = DEFAULT,
    progress: bool = False,
    offsets: bool = True,
    torque: bool = False,
) -> tuple[InteractionRows, LogReport]:
    """Read flight logs (`.csv`, `.parquet`), tables of rows (`.npz`), or a folder of both.

    The report says of every file what became of it. Of a folder that `swarm-envs collect` wrote,
    `rows.npz` is read.

    Args:
        path: the file or folder.
        options: how logs become rows, and what is held out.
        progress: show a progress bar.
        offsets: leave out vehicles whose calibration offset is unknown for want of quiet rows.
        torque: leave out files without labels of the torque.

    Raises:
        FileNotFoundError: there is nothing to read.
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: no file is sound, or no row is left; the message says why.
    """
    if not offsets:
        options = dataclasses.replace(options, min_quiet_rows=0)
    files, not_read = find_files(path)
    if not files:
        raise FileNotFoundError(
            f"{str(path)!r} has no flight log and no table of rows, only "
            f"{', '.join(not_read[:5]) or 'nothing'}; put .csv, .parquet or .npz files there"
        )
    parts, refused = list[JoinedRows](), list[FileReport]()
    known = dict[str, str]()
    for file in tqdm(files, disable=not progress, unit="file"):
        try:
            table, report, key = read_file(file, options)
            if torque and table.torque is None:
                raise ValueError(
                    f"{file.name}: a torque head is wanted, but it has no array `torque` (R, 3), "
                    "N m in the world frame; add it, or fit without --torque"
                )
            refuse_copy(known, key, file.name)
        except ValueError as error:
            refused.append(FileReport(file.name, str(error)))
        else:
            parts.append(JoinedRows(table, np.zeros(len(table), np.int64), [report]))
    if not parts:
        reasons = "; ".join(str(file.refused) for file in refused)
        where = f"no file of {str(path)!r} is sound: " if path.is_dir() else ""
        raise ValueError(where + reasons)
    joined = hold_out_blocks(_joined(parts), options)
    rows, found = without_scarce_data(joined, refused, options)
    return rows, dataclasses.replace(found, not_read=not_read)


def find_files(path: Path) -> tuple[list[Path], tuple[str, ...]]:
    """Return the logs and tables at a path, sorted by name, and what else lies in the folder.

    The path is itself a file, or a folder in which they lie. Endings count in capitals too.

    Raises:
        FileNotFoundError: there is no such path.
    """
    if not path.exists():
        raise FileNotFoundError(
            f"no data at {str(path)!r}; give a file of rows or logs, or a folder"
        )
    if not path.is_dir():
        return [path], ()
    if (path / MANIFEST).is_file():
        if not (path / "rows.npz").is_file():
            raise FileNotFoundError(
                f"{str(path)!r} has no rows.npz: the collection was not finished; run "
                "`swarm-envs collect` again with the same options"
            )
        return [path / "rows.npz"], ()
    visible = sorted(file for file in path.iterdir() if not file.name.startswith("."))
    files = [f for f in visible if f.is_file() and f.suffix.lower() in (*SUFFIXES, TABLE_SUFFIX)]
    others = (file for file in visible if file not in files)
    return files, tuple(f"{f.name}/" if f.is_dir() else f.name for f in others)


def read_file(file: Path, options: LogOptions) -> tuple[InteractionRows, FileReport, str]:
    """Return the rows of a file, what became of it, and what it shares with its copies.

    Raises:
        ValueError: it breaks a rule; the message begins with its name.
    """
    if file.suffix.lower() != TABLE_SUFFIX:
        return read_log(file, options)
    try:
        rows = read_rows(file)
        notes = check_row_table(rows)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error
    report = FileReport(file.name, entries=len(rows), rate_hz=options.rate_hz, notes=notes)
    return rows, report, table_key(rows)


def read_log(file: Path, options: LogOptions) -> tuple[InteractionRows, FileReport, str]:
    """Return the rows of a flight log as `read_file` does; none is held out yet.

    Raises:
        ImportError: it is Parquet, and pyarrow is not installed.
        ValueError: it breaks a rule; the message begins with its name.
    """
    table = read_table(file)
    try:
        drones = checked_drones(table)
        clocked = common_clock(drones, options)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error
    force = interaction_force_g(clocked, options.smoothing_s)
    parts = [drone_rows(clocked, force, i, options.keep_every) for i in range(len(drones))]
    dropped = {
        reason: sum(part.dropped.get(reason, 0) for part in parts)
        for part in parts
        for reason in part.dropped
    }
    rows = rows_of_drones(
        parts,
        slots=len(drones) - 1,
        flight=[0] * len(drones),
        vehicle=range(len(drones)),
        held_out=np.zeros(sum(len(part.step) for part in parts), dtype=np.bool_),
        names={i: drone.name for i, drone in enumerate(drones)},
    )
    report = _log_report(file.name, drones, clocked, table.ignored)
    return rows, dataclasses.replace(report, dropped=dropped), flight_key(drones)


def _log_report(
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


def _joined(parts: Sequence[JoinedRows]) -> JoinedRows:
    # A table alone keeps its numbers of flights and vehicles.
    rows = join_rows([part.rows for part in parts]) if len(parts) > 1 else parts[0].rows
    origin = np.repeat(np.arange(len(parts)), [len(part.rows) for part in parts])
    return JoinedRows(rows, origin, [file for part in parts for file in part.files])


def hold_out_blocks(joined: JoinedRows, options: LogOptions) -> JoinedRows:
    """Hold out blocks of time of the flights of files that come without marks.

    Flights of the same scenarios share held-out blocks evenly. Training rows in a guard gap of a
    block are left out.
    """
    rows = joined.rows
    marked = np.bincount(joined.origin[rows.validation], minlength=len(joined.files)) > 0
    chosen = ~marked[joined.origin]
    if not chosen.any():
        return joined
    held_out, guarded = rows.validation.copy(), np.zeros(len(rows), dtype=np.bool_)
    flights = [np.flatnonzero(rows.flight == flight) for flight in np.unique(rows.flight[chosen])]
    flights.sort(key=lambda own: tuple(np.unique(rows.scenario[own])))
    times = [_seconds(joined, own) for own in flights]
    lengths = [block_count(float(time.max()), options) for time in times]
    blocks = held_out_blocks(lengths, options.validation_share, options.split_seed)
    for own, time, block in zip(flights, times, blocks, strict=True):
        held_out[own] = is_held_out(time, block, options)
        guarded[own] = is_guarded(time, block, options)
    rows = dataclasses.replace(rows, validation=held_out)
    return JoinedRows(rows, joined.origin, joined.files).select(~guarded, "guard gap")


def _seconds(joined: JoinedRows, own: npt.NDArray[np.int64]) -> FloatArray:
    """Return the times of the rows of a flight since its first, s."""
    step = joined.rows.step[own]
    rate_hz = joined.files[joined.origin[own[0]]].rate_hz
    return np.asarray((step - step.min()) / rate_hz)


def flight_key(drones: Sequence[DroneLog]) -> str:
    """Return what a flight and its copies share: motion and signals of its drones.

    Names, origin of time, the order of the drones and digits beyond float32 make no difference.
    """
    keys = (_digest(d.position, d.velocity, d.quaternion, d.pwm) for d in drones)
    return hashlib.sha256("".join(sorted(keys)).encode()).hexdigest()


def table_key(rows: InteractionRows) -> str:
    """Return what a table and its copies share: inputs by step, without labels and marks."""
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


def data_sha256(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file, or of names and contents of a folder's files."""
    if not path.is_dir():
        return file_sha256(path)
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        if file.is_file() and not file.name.startswith("."):
            digest.update(f"{file.name}\0{data_sha256(file)}\n".encode())
    return digest.hexdigest()
