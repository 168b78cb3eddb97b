"""The table of one flight, and its file: CSV or Parquet. The package describes the format."""

from __future__ import annotations

import csv
import difflib
import itertools
import os
import re
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.files import pyarrow, written_whole
from swarm_envs.state import FloatArray

__all__ = ["GROUPS", "SUFFIXES", "FlightTable", "read_table", "write_flight_table"]

TEXT = ("drone", "type")  # Columns that hold names
GROUPS: dict[str, tuple[str, ...]] = {
    "time": ("time",),
    "position": ("x", "y", "z"),
    "velocity": ("vx", "vy", "vz"),
    "quaternion": ("qx", "qy", "qz", "qw"),
    "acceleration": ("ax", "ay", "az"),
    "pwm": ("pwm1", "pwm2", "pwm3", "pwm4"),
    "voltage": ("voltage",),
}
"""Columns of numbers by the field of `FlightTable` that holds them."""
OPTIONAL = GROUPS["acceleration"]  # Columns that may be left out
COLUMNS = (*TEXT, *itertools.chain.from_iterable(GROUPS.values()))  # Every column that is read
REQUIRED = tuple(name for name in COLUMNS if name not in OPTIONAL)  # Columns that must be there
SUFFIXES = (".csv", ".parquet")
"""How names of logs end."""

_OTHERWISE = "write the table as CSV"  # What to do without pyarrow
_EMPTY = "the file is empty; copy it again or delete it"

Columns = Mapping[str, npt.NDArray[Any]]  # Columns by name, each (lines,)


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
    ignored: tuple[str, ...] = ()
    """Columns of the file that have no meaning here."""

    def __len__(self) -> int:
        """Number of lines R."""
        return len(self.time)

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return the table's columns by their names."""
        found: dict[str, npt.NDArray[Any]] = {"drone": self.drone, "type": self.type}
        for group, names in GROUPS.items():
            values = getattr(self, group)
            if values is not None:
                found |= zip(names, values.reshape(len(self), len(names)).T, strict=True)
        return found


def from_columns(columns: Columns) -> FlightTable:
    """Build a table from columns by their names; all but `ax ay az` must be there.

    Raises:
        ValueError: a column is missing; the message names the nearest that is there.
    """
    check_columns(tuple(columns))
    fields: dict[str, Any] = {}
    for group, names in GROUPS.items():
        if group == "acceleration" and names[0] not in columns:
            fields[group] = None
            continue
        values = np.stack([np.asarray(columns[n], dtype=np.float64) for n in names], axis=-1)
        fields[group] = values[:, 0] if len(names) == 1 else values
    ignored = tuple(name for name in columns if name not in COLUMNS)
    fields |= {name: np.asarray(columns[name], dtype=np.str_) for name in TEXT}
    return FlightTable(**fields, ignored=ignored)


def check_columns(names: Sequence[str]) -> None:
    """Check that every column is there once."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"column {twice[0]!r} is there more than once; keep one")
    partly = [n for n in OPTIONAL if n not in names] if set(OPTIONAL) & set(names) else []
    missing = [*(name for name in REQUIRED if name not in names), *partly]
    if missing:
        raise ValueError(_missing(missing, names))


def _missing(missing: Sequence[str], names: Sequence[str]) -> str:
    unknown = [name for name in names if name not in COLUMNS]
    near = difflib.get_close_matches(missing[0], unknown, n=1, cutoff=0.3)
    hint = f"the nearest there is {near[0]!r}; rename it, or " if near else ""
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        hint = "separate columns by commas, or "
    rest = f" (and {len(missing) - 1} more: {', '.join(missing[1:])})" if len(missing) > 1 else ""
    return f"column {missing[0]!r} is missing{rest}; {hint}add it; there are {', '.join(names)}"


@typed
def read_table(path: str | os.PathLike[str]) -> FlightTable:
    """Read the file of one flight; its values are not judged yet, see `checks.checked_drones`.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: it is Parquet, and pyarrow is not installed.
        ValueError: it is no such table; the message says what is wrong where.
    """
    file = Path(path)
    ending = file.suffix.lower()
    if ending not in SUFFIXES:
        raise ValueError(
            f"path {file.name!r} ends in {file.suffix!r}, but must in .csv or .parquet (logs), or "
            ".npz (rows)"
        )
    if not file.is_file():
        raise FileNotFoundError(f"no flight log at {os.fspath(path)!r}; give its path")
    try:
        return from_columns(_read_csv(file) if ending == ".csv" else _read_parquet(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"path {file.name!r} is no table of text in UTF-8: {error}") from error


def _read_csv(path: Path) -> Columns:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        lines = (row for row in reader if "".join(row).strip())
        names = [name.strip() for name in next(lines, [])]
        if not names:
            raise ValueError(_EMPTY)
        check_columns(names)
        known = [i for i, name in enumerate(names) if name in COLUMNS and name not in TEXT]
        text = [names.index(name) for name in TEXT]
        words, numbers = list[list[str]](), array("d")
        for row in lines:
            if len(row) <= max(*known, *text):
                raise ValueError(
                    f"line {reader.line_num} has {len(row)} values; write one value for each of "
                    f"the {len(names)} columns"
                )
            words.append([row[i].strip() for i in text])
            for i in known:
                try:
                    numbers.append(float(row[i]))
                except ValueError:
                    raise ValueError(
                        f"column {names[i]!r} holds {row[i]!r:.80} in line {reader.line_num}, but "
                        "must hold finite numbers; mend or remove the line"
                    ) from None
    if not words:
        raise ValueError("no line follows the header; log at least a second of flight")
    table = np.frombuffer(numbers).reshape(len(words), -1)
    found: dict[str, npt.NDArray[Any]] = {name: np.zeros(0) for name in names}
    found |= {names[i]: column for i, column in zip(known, table.T, strict=True)}
    return found | dict(zip(TEXT, np.array(words).T, strict=True))


def _read_parquet(path: Path) -> Columns:
    _, parquet = pyarrow(path.name, _OTHERWISE)
    if path.stat().st_size == 0:
        raise ValueError(_EMPTY)
    try:
        table = parquet.read_table(path)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{path.name} cannot be read ({error}); copy it again or delete it"
        ) from error
    check_columns(table.column_names)
    if table.num_rows == 0:
        raise ValueError("no row; log at least a second of flight")
    found: dict[str, npt.NDArray[Any]] = {}
    for name in table.column_names:
        if name in TEXT:
            found[name] = np.array([str(value).strip() for value in table[name].to_pylist()])
        elif name in COLUMNS:
            found[name] = _numbers(name, table[name].to_numpy())
        else:
            found[name] = np.zeros(0)
    return found


def _numbers(name: str, values: npt.NDArray[Any]) -> FloatArray:
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"column {name!r} must hold finite numbers: {error}") from None


@typed
def write_flight_table(path: str | os.PathLike[str], table: FlightTable) -> None:
    """Write a flight's table, atomically, so that `read_table` gives exactly the same.

    Args:
        path: the file, ending in `.csv` or `.parquet`.
        table: what to write.

    Raises:
        ImportError: it is to be Parquet, and pyarrow is not installed.
        ValueError: the file's ending is another.
    """
    target = Path(path)
    if target.suffix not in SUFFIXES:
        raise ValueError(f"{target.name} ends in {target.suffix!r}, but must in .csv or .parquet")
    columns = table.columns()
    with written_whole(target) as partial:
        _write_columns(partial, columns)


def _write_columns(target: Path, columns: dict[str, npt.NDArray[Any]]) -> None:
    if target.suffix == ".csv":
        with target.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    else:
        arrow, parquet = pyarrow(target.name, _OTHERWISE)
        parquet.write_table(arrow.table({n: v.tolist() for n, v in columns.items()}), target)
