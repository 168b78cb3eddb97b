"""The table of one flight, read from CSV or Parquet with the columns of `COLUMNS`.

A file is read by the names of its columns. Values outside the range of a column raise an error with
the line; units are not converted.
"""

from __future__ import annotations

import csv
import os
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.files import pyarrow
from swarm_envs.state import FloatArray, IntArray

__all__ = ["COLUMNS", "SUFFIXES", "Column", "FlightTable", "read_table"]


class Column(NamedTuple):
    """A column of a flight log."""

    unit: str
    """The unit of its numbers; `text` for names."""
    meaning: str
    """Its quantity."""
    low: float = -np.inf
    """The lowest allowed value."""
    high: float = np.inf
    """The highest allowed value."""


_PLACE = Column("m", "position; world frame, z up, ground at z = 0", -200.0, 200.0)
_SPEED = Column("m/s", "velocity; world frame", -30.0, 30.0)
_ATTITUDE = Column("", "attitude as a unit quaternion, body to world, z along thrust", -1.01, 1.01)
_ACCELERATION = Column(
    "m/s^2", "acceleration, world frame, +9.81 in az in hover; optional", -200.0, 200.0
)
_PWM = Column("", "signal of a motor", 0.0, 65535.0)

COLUMNS: Mapping[str, Column] = {
    "time": Column("s", "time, of one clock for all drones of the flight"),
    "drone": Column("text", "name of the vehicle, the same in every file"),
    "type": Column("text", "type of the vehicle: S, L or S*"),
    **dict.fromkeys(("x", "y"), _PLACE),
    "z": _PLACE._replace(low=-0.5),
    **dict.fromkeys(("vx", "vy", "vz"), _SPEED),
    **dict.fromkeys(("qx", "qy", "qz", "qw"), _ATTITUDE),
    **dict.fromkeys(("ax", "ay", "az"), _ACCELERATION),
    **dict.fromkeys(("pwm1", "pwm2", "pwm3", "pwm4"), _PWM),
    "voltage": Column("V", "voltage of the battery under load, of one cell", 2.5, 4.5),
}
"""The columns of a flight log by name: units, meanings and ranges. `ax ay az` may be left out."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "time": ("time",),
    "position": ("x", "y", "z"),
    "velocity": ("vx", "vy", "vz"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "acceleration": ("ax", "ay", "az"),
    "pwm": ("pwm1", "pwm2", "pwm3", "pwm4"),
    "voltage": ("voltage",),
}
"""Numeric columns by field of `FlightTable`."""
TEXT = ("drone", "type")  # Columns of names
OPTIONAL = GROUPS["acceleration"]
SUFFIXES = (".csv", ".parquet")
"""Suffixes of logs, in lower or upper case."""

Columns = Mapping[str, npt.NDArray[Any]]  # Columns by name, each (lines,)


def columns_text() -> str:
    """Return the columns with their units in one line, for messages and help."""
    words = []
    for name, column in COLUMNS.items():
        unit = f" ({column.unit})" if column.unit else ""
        words.append(f"{name}{unit}")
    return ", ".join(words)


@dataclass(frozen=True)
class FlightTable:
    """One flight, R lines: one drone at one time. World frame, z up, SI units."""

    drone: npt.NDArray[np.str_]
    """(R,) name of the physical vehicle."""
    type: npt.NDArray[np.str_]
    """(R,) its type, a token such as `S`."""
    time: FloatArray
    """(R,) s."""
    position: FloatArray
    """(R, 3) m."""
    velocity: FloatArray
    """(R, 3) m/s."""
    quaternion: FloatArray
    """(R, 4) attitude (x, y, z, w), body to world."""
    acceleration: FloatArray | None
    """(R, 3) m/s^2 with gravity, (0, 0, +9.81) in hover; None where it was not logged."""
    pwm: FloatArray
    """(R, 4) motor signals, 0 to 65535."""
    voltage: FloatArray
    """(R,) battery voltage, V."""
    line: IntArray
    """(R,) line of the file, the header being line 1; a Parquet file counts its rows from 1."""
    ignored: tuple[str, ...] = ()
    """Columns of the file that are not used."""

    def __len__(self) -> int:
        """Number of lines R."""
        return len(self.time)


def from_columns(columns: Columns, line: IntArray | None = None) -> FlightTable:
    """Build a table from columns by name; only `ax ay az` may be missing.

    Raises:
        ValueError: a column is missing, or a value is outside the range of its column.
    """
    check_names(tuple(columns))
    if line is None:
        line = np.arange(len(columns["time"])) + 2
    fields: dict[str, Any] = {}
    for group, names in GROUPS.items():
        if names[0] not in columns:
            fields[group] = None
            continue
        values = np.stack([np.asarray(columns[n], dtype=np.float64) for n in names], axis=-1)
        for name, column in zip(names, values.T, strict=True):
            _check_range(name, column, line)
        fields[group] = values[:, 0] if len(names) == 1 else values
    fields |= {name: np.asarray(columns[name], dtype=np.str_) for name in TEXT}
    for name in TEXT:
        _refuse(fields[name] == "", line, f"column {name!r} is empty", "name the vehicle and type")
    ignored = tuple(name for name in columns if name not in COLUMNS)
    return FlightTable(**fields, line=line, ignored=ignored)


def check_names(names: Sequence[str]) -> None:
    """Check that every column of a file exists once."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"column {twice[0]!r} exists more than once; keep one")
    optional = set(OPTIONAL) & set(names)
    missing = [n for n in COLUMNS if n not in names and (optional or n not in OPTIONAL)]
    if missing:
        raise ValueError(
            f"column {missing[0]!r} is missing; there are {', '.join(names)}, but a flight log has "
            f"the columns {columns_text()}, separated by commas; ax, ay and az may be left out"
        )


def _check_range(name: str, values: FloatArray, line: IntArray) -> None:
    column = COLUMNS[name]
    for bad, rule in (
        (~np.isfinite(values), "be a finite number"),
        ((values < column.low) | (values > column.high), _range_text(column)),
    ):
        k = int(np.argmax(bad))
        _refuse(bad, line, f"column {name!r} is {values[k]:g}, but must {rule}", "correct it")


def _range_text(column: Column) -> str:
    return f"lie between {column.low:g} and {column.high:g} {column.unit}".rstrip()


def _refuse(bad: npt.NDArray[np.bool_], line: IntArray, reason: str, fix: str) -> None:
    if bad.any():
        raise ValueError(f"line {line[int(np.argmax(bad))]}: {reason}; {fix}")


def read_table(path: str | os.PathLike[str]) -> FlightTable:
    """Read the file of one flight.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: it is Parquet, and pyarrow is not installed.
        ValueError: it is invalid; the message begins with the file, and the line if there is one.
    """
    file = Path(path)
    ending = file.suffix.lower()
    if not file.exists():
        raise FileNotFoundError(f"no flight log at {os.fspath(path)!r}; give its path")
    try:
        if ending not in SUFFIXES or not file.is_file():
            raise ValueError(f"the name must end in {' or '.join(SUFFIXES)} (or .npz for rows)")
        if file.stat().st_size == 0:
            raise ValueError("the file is empty; copy it again or delete it")
        columns, line = _read_csv(file) if ending == ".csv" else _read_parquet(file)
        return from_columns(columns, line)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file.name}: this is no table of text in UTF-8: {error}") from error
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error


def _read_csv(path: Path) -> tuple[Columns, IntArray]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        lines = _numbered_lines(csv.reader(file))
        names = [name.strip() for name in next(lines, (0, [""]))[1]]
        check_names(names)
        numeric = [i for i, name in enumerate(names) if name in COLUMNS and name not in TEXT]
        text = [names.index(name) for name in TEXT]
        words, numbers, places = list[list[str]](), array("d"), list[int]()
        for number, row in lines:
            if len(row) != len(names):
                raise ValueError(
                    f"line {number}: it has {len(row)} values, but the header {len(names)} "
                    "columns; write one value for each column"
                )
            words.append([row[i].strip() for i in text])
            numbers.extend(_number(row[i], names[i], number) for i in numeric)
            places.append(number)
    if not words:
        raise ValueError("no line follows the header; log at least a second of flight")
    table = np.frombuffer(numbers).reshape(len(words), -1)
    found: dict[str, npt.NDArray[Any]] = {name: np.zeros(0) for name in names}
    found |= {names[i]: column for i, column in zip(numeric, table.T, strict=True)}
    return found | dict(zip(TEXT, np.array(words).T, strict=True)), np.array(places)


def _numbered_lines(reader: Any) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines that are not blank, with their numbers in the file."""
    for row in reader:
        if "".join(row).strip():
            yield reader.line_num, row


def _number(text: str, name: str, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"line {line}: column {name!r} is {text!r:.80}, but must be a finite number; correct "
            "or remove the line"
        ) from None


def _read_parquet(path: Path) -> tuple[Columns, IntArray]:
    arrow, parquet = pyarrow(path.name, "write the table as CSV")
    try:
        with path.open("rb") as opened:  # pyarrow takes no path that is not Unicode
            file = parquet.ParquetFile(opened)
            names, rows = file.schema_arrow.names, file.metadata.num_rows
            check_names(names)
            if not rows:
                raise ValueError("it has no row; log at least a second of flight")
            for name in names:
                _check_kind(arrow, name, file.schema_arrow.field(name).type)
            table = file.read(columns=[name for name in names if name in COLUMNS])
    except (arrow.ArrowException, OSError) as error:
        raise ValueError(f"it cannot be read ({error}); copy it again or delete it") from error
    found: dict[str, npt.NDArray[Any]] = {name: np.zeros(0) for name in names}
    line = np.arange(rows) + 1
    for name in table.column_names:
        column = table[name]
        empty = np.asarray(column.is_null())
        _refuse(empty, line, f"column {name!r} is empty", "remove rows that hold no measurement")
        if name in TEXT:
            found[name] = np.array([value.strip() for value in column.to_pylist()])
        else:
            found[name] = column.to_numpy().astype(np.float64)
    return found, line


def _check_kind(arrow: Any, name: str, kind: Any) -> None:
    """Check that a column of a Parquet file has text or numbers, as it must."""
    types = arrow.types
    if types.is_dictionary(kind):
        kind = kind.value_type
    text = types.is_string(kind) or types.is_large_string(kind)
    number = types.is_floating(kind) or types.is_integer(kind)
    if name in COLUMNS and not (text if name in TEXT else number):
        expected = "text" if name in TEXT else "numbers"
        raise ValueError(f"column {name!r} has type {kind}, but must have {expected}")
