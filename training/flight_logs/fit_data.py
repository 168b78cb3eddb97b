"""The rows of a fit: tables of rows, flight logs that are made into rows, or a folder of both."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from swarm_envs.training.collection.collect import MANIFEST
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
from swarm_envs.training.flight_logs.read import (
    Found,
    find_data,
    join_logs,
    read_logs,
    refuse_copy,
    table_key,
)
from swarm_envs.training.interaction_rows import InteractionRows, read_rows
from swarm_envs.training.interaction_rows.row_tables import check_row_table, join_rows, notes_of
from swarm_envs.training.provenance import file_sha256

__all__ = ["data_sha256", "read_data"]


def read_data(
    path: Path,
    options: LogOptions,
    progress: bool = False,
    offsets: bool = True,
    torque: bool = False,
) -> tuple[InteractionRows, LogReport]:
    """Read tables of rows (`.npz`), flight logs (`.csv`, `.parquet`), or a folder of both.

    What is sound is joined; the report says of every file what became of it. A folder that
    `swarm-envs collect` wrote is read as that. With `offsets`, vehicles are left out whose
    calibration offset is unknown for want of quiet rows; with `torque`, tables without
    labels of it.

    Raises:
        FileNotFoundError: there is nothing to read.
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: no file is sound, or what is left is no row; the message says why.
    """
    if not offsets:
        options = dataclasses.replace(options, min_quiet_rows=0)
    there = Found([], [path], []) if (path / MANIFEST).is_file() else find_data(path)
    tables, logs = there.tables, there.logs
    if not tables:
        if torque:
            raise ValueError(_no_torque(path.name, "a flight log"))
        return read_logs(path, options, progress)
    parts, refused = _read_tables(tables, options, torque)
    refused += there.twice
    if logs and not torque:
        joined, bad = join_logs(logs, options, progress)
        parts, refused = [*([] if joined is None else [joined]), *parts], [*bad, *refused]
    elif logs:
        refused += [FileReport(file.name, _no_torque(file.name, "a log")) for file in logs]
    if not parts:
        raise ValueError(_nothing(path, refused))
    rows, report = without_scarce_data(
        _with_drawn_blocks(_joined(parts), options), refused, options
    )
    flown = {k: s for k, s in report.scenarios.items() if s.training_rows or s.validation_rows}
    return rows, dataclasses.replace(report, scenarios=flown, not_read=there.not_read)


def _read_tables(
    files: Sequence[Path], options: LogOptions, torque: bool
) -> tuple[list[JoinedRows], list[FileReport]]:
    parts, refused, known = [], [], dict[str, str]()
    for file in files:
        try:
            rows = read_rows(file)
            check_row_table(rows, options.check_units)
            if torque and rows.torque is None:
                raise ValueError(_no_torque(file.name, "the table"))
            refuse_copy(known, table_key(rows), file.name)
        except ValueError as error:
            refused.append(FileReport(file.name, str(error), kind="table"))
        else:
            report = FileReport(file.name, kind="table", entries=len(rows), notes=notes_of(rows))
            parts.append(JoinedRows(rows, np.zeros(len(rows), np.int64), [report]))
    return parts, refused


def _joined(parts: Sequence[JoinedRows]) -> JoinedRows:
    # A table alone keeps its numbers of flights and vehicles.
    rows = join_rows([part.rows for part in parts]) if len(parts) > 1 else parts[0].rows
    first = np.cumsum([0, *(len(part.files) for part in parts)])
    origin = [part.origin + at for part, at in zip(parts, first)]
    return JoinedRows(rows, np.concatenate(origin), [f for part in parts for f in part.files])


def _no_torque(name: str, what: str) -> str:
    return (
        f"a torque head is wanted, but {what} carries no torque; add an array `torque` (R, 3), N m "
        f"in the world frame, to {name}, or fit without --torque"
    )


def _nothing(path: Path, refused: Sequence[FileReport]) -> str:
    if len(refused) == 1 and not path.is_dir():
        return f"{refused[0].file}: {refused[0].refused}"
    counts = Counter(file.kind for file in refused)
    what = " and ".join(f"{count} {kind}s" for kind, count in counts.items())
    reasons = "; ".join(f"{file.file}: {file.refused}" for file in refused)
    return f"none of {what} in {str(path)!r} is sound: {reasons}"


def data_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, or of the names and contents of a folder's files."""
    if not path.is_dir():
        return file_sha256(path)
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        if file.is_file() and not file.name.startswith("."):
            digest.update(f"{file.name}\0{data_sha256(file)}\n".encode())
    return digest.hexdigest()


def _with_drawn_blocks(joined: JoinedRows, options: LogOptions) -> JoinedRows:
    """Hold out blocks of time of the flights of tables without marks, or of every table."""
    tables = np.array([file.kind == "table" for file in joined.files])
    held_out = np.bincount(joined.origin[joined.rows.validation], minlength=len(tables))
    drawn = tables & ((held_out == 0) | options.resplit)
    chosen = drawn[joined.origin]
    if not chosen.any():
        return joined
    rows = joined.rows
    marked, guarded = rows.validation & ~chosen, np.zeros(len(rows), dtype=np.bool_)
    places = [np.flatnonzero(rows.flight == flight) for flight in np.unique(rows.flight[chosen])]
    times = [(rows.step / options.rate_hz)[place] for place in places]
    times = [time - time.min() for time in times]
    lengths = [block_count(float(time.max()), options) for time in times]
    blocks = held_out_blocks(lengths, options.validation_share, options.split_seed)
    for place, time, own in zip(places, times, blocks, strict=True):
        marked[place] = is_held_out(time, own, options)
        guarded[place] = is_guarded(time, own, options)
    note = f"held-out blocks of {options.block_s:g} s are drawn, {options.guard_s:g} s apart"
    files = [
        dataclasses.replace(f, notes=(*f.notes, note)) if d else f
        for f, d in zip(joined.files, drawn, strict=True)
    ]
    rows = dataclasses.replace(rows, validation=marked)
    return JoinedRows(rows, joined.origin, files).select(~guarded, "guard gap")
