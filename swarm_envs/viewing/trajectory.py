"""Trajectory files: writing and reading of a recorded episode as a Parquet table or as npz.

A Parquet file is a long table with the columns `COLUMNS` and one row for each drone at each time,
sorted by time and drone when it is written, and in any order when it is read. Columns of flight
logs have the same names. Constants of the episode are JSON in the schema's metadata, under the key
`swarm_envs`. An npz file has the fields of `Recording` as arrays (T, N, ...) and the same JSON as
the string `about`, without pickles. Numbers are float64 and are read exactly as written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import check_type, unknown_name
from swarm_envs.files import parse_note, pyarrow, read_npz, written_whole
from swarm_envs.vehicles import Vehicle
from swarm_envs.viewing.record import About, Recording, Solid

__all__ = ["check_trajectory_path", "read_trajectory", "write_trajectory"]

GROUPS: Mapping[str, tuple[str, ...]] = {
    "position": ("x", "y", "z"),  # m, world frame, z up
    "velocity": ("vx", "vy", "vz"),  # m/s, world frame
    "quaternion": ("qx", "qy", "qz", "qw"),  # unit quaternion, body to world
    "rotor_thrust": ("thrust1", "thrust2", "thrust3", "thrust4"),  # N
    "force": ("fx", "fy", "fz"),  # N, interaction force, world frame
    "reference": ("x_reference", "y_reference", "z_reference"),  # m
    "goal": ("x_goal", "y_goal", "z_goal"),  # m
    "setpoint": ("x_setpoint", "y_setpoint", "z_setpoint"),  # m
    "contact_drone": ("contact_drone",),  # index of the drone it touches, or -1
    "contact_floor": ("contact_floor",),
    "contact_wall": ("contact_wall",),  # or the ceiling
    "contact_obstacle": ("contact_obstacle",),  # index of the obstacle it touches, or -1
    "tumbling": ("tumbling",),  # turns faster than 150 rad/s
    "reward": ("reward",),  # weighted sum of the terms; NaN if unknown
}
"""Columns of the table by field of `Recording`."""

COLUMNS = ("time", "drone", "type", *(c for group in GROUPS.values() for c in group))
"""All columns except `reward_<term>`, one for each reward term of the task."""

_TERM = "reward_"
_INTEGERS = ("contact_drone", "contact_obstacle")
_FLAGS = ("contact_floor", "contact_wall", "tumbling")
_KEY = b"swarm_envs"
_SUFFIXES = (".parquet", ".npz")
_UNIT_TOLERANCE = 0.01  # Largest difference of the length of a quaternion from 1

Arrays = Mapping[str, npt.NDArray[Any]]  # Arrays by name


def check_trajectory_path(path: str | Path) -> Path:
    """Return the path of a trajectory file, after a check of its suffix and of the library.

    Raises:
        ValueError: the suffix is neither `.parquet` nor `.npz`.
        ImportError: the suffix is `.parquet`, and pyarrow is not installed.
    """
    check_type("path", path, str | Path)
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise ValueError(unknown_name("suffix", path.suffix, _SUFFIXES, f"of {str(path)!r}"))
    if path.suffix.lower() == ".parquet":
        _arrow()
    return path


def write_trajectory(path: str | Path, recording: Recording) -> None:
    """Write an episode atomically.

    Args:
        path: the file, with the suffix `.parquet` or `.npz`.
        recording: the episode.

    Raises:
        ValueError: the file has another suffix.
        ImportError: the suffix is `.parquet`, and pyarrow is not installed.
        OSError: the file cannot be written.
    """
    path = check_trajectory_path(path)
    with written_whole(path) as partial:
        if path.suffix.lower() == ".npz":
            arrays: dict[str, Any] = {name: getattr(recording, name) for name in GROUPS}
            terms = {_TERM + name: term for name, term in recording.reward_terms.items()}
            arrays |= {"time": recording.time, "about": np.array(_about_json(recording)), **terms}
            with partial.open("wb") as file:  # numpy would append .npz to a name in capitals
                np.savez_compressed(file, **arrays)
        else:
            _write_parquet(partial, recording)


def read_trajectory(path: str | Path) -> Recording:
    """Read an episode that `write_trajectory` wrote.

    Raises:
        ValueError: the file has another suffix, or is no valid episode.
        ImportError: the suffix is `.parquet`, and pyarrow is not installed.
        OSError: the file cannot be read.
    """
    path = check_trajectory_path(path)
    read = _read_npz if path.suffix.lower() == ".npz" else _read_parquet
    try:
        arrays, about = read(path)
        team = tuple(map(_vehicle, about.pop("team")))
        about["arena"] = tuple(map(tuple, about["arena"]))
        about["solids"] = tuple(
            Solid(r, tuple(low), tuple(high)) for r, low, high in about["solids"]
        )
        terms = {name: arrays[_TERM + name] for name in about.pop("reward_terms")}
        fields = {name: arrays[name] for name in ("time", *GROUPS)}
        _check_arrays(path, len(team), fields, terms)
        return Recording(team=team, reward_terms=terms, about=About(**about), **fields)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} has no episode, or is damaged: {error!r}") from error


def _check_arrays(path: Path, drones: int, fields: Arrays, terms: Arrays) -> None:
    """Raise ValueError for wrong shapes, times that do not increase, and invalid states."""
    steps = len(fields["time"])
    shapes = {name: (len(group),) if len(group) > 1 else () for name, group in GROUPS.items()}
    for name, array in {**fields, **terms}.items():
        expected = (steps,) if name == "time" else (steps, drones, *shapes.get(name, ()))
        if array.shape != expected or array.dtype.kind not in "biuf":
            raise ValueError(
                f"{name} in {path} is {array.dtype} of shape {array.shape}, but must be numbers of "
                f"shape {expected}"
            )
    for name in ("time", "position", "velocity", "quaternion"):
        if not np.isfinite(fields[name]).all():
            raise ValueError(f"{name} in {path} has a number that is not finite")
    if steps == 0 or (np.diff(fields["time"]) <= 0.0).any():
        raise ValueError(f"time in {path} must increase from sample to sample")
    length = np.linalg.norm(fields["quaternion"], axis=-1)
    if (np.abs(length - 1.0) > _UNIT_TOLERANCE).any():
        raise ValueError(f"quaternion in {path} has length {length.min():g}, but must be 1")


def columns(recording: Recording) -> dict[str, npt.NDArray[Any]]:
    """Return the columns (T * N,) of the long table by name."""
    steps, drones = recording.position.shape[:2]
    names = np.array([f"drone_{i}" for i in range(drones)])
    tokens = np.array([vehicle.token for vehicle in recording.team])
    table: dict[str, npt.NDArray[Any]] = {
        "time": np.repeat(recording.time, drones),
        "drone": np.tile(names, steps),
        "type": np.tile(tokens, steps),
    }
    for field, group in GROUPS.items():
        values = getattr(recording, field).reshape(steps * drones, len(group))
        table |= zip(group, values.T, strict=True)
    for name, term in recording.reward_terms.items():
        table[_TERM + name] = term.reshape(-1)
    return table


def _vehicle(values: Mapping[str, Any]) -> Vehicle:
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    return Vehicle(**fields)


def _about_json(recording: Recording) -> str:
    about = asdict(recording.about)
    about["team"] = [asdict(vehicle) for vehicle in recording.team]
    about["reward_terms"] = list(recording.reward_terms)
    return json.dumps(about)


def _write_parquet(path: Path, recording: Recording) -> None:
    arrow, parquet = _arrow()
    table = arrow.table({name: arrow.array(c) for name, c in columns(recording).items()})
    table = table.replace_schema_metadata({_KEY: _about_json(recording).encode()})
    with path.open("wb") as file:  # pyarrow takes no path that is not Unicode
        parquet.write_table(table, file, compression="zstd")


def _read_parquet(path: Path) -> tuple[Arrays, dict[str, Any]]:
    _, parquet = _arrow()
    with path.open("rb") as file:  # so that a missing file raises OSError
        try:
            table = parquet.read_table(file)
        except Exception as error:
            raise ValueError(f"{path} is not a Parquet file: {error}") from error
    metadata = table.schema.metadata or {}
    if _KEY not in metadata:
        raise ValueError(f"{path} has no episode: its metadata lack {_KEY.decode()!r}")
    about = parse_note(metadata[_KEY].decode())
    terms = [_TERM + name for name in about["reward_terms"]]
    _check_names(path, (*COLUMNS, *terms), table.column_names)
    drones = len(about["team"])
    if table.num_rows == 0 or table.num_rows % drones:
        raise ValueError(
            f"{path} has {table.num_rows} rows, but must have a positive multiple of {drones}, its "
            "number of drones"
        )
    order = _by_time_and_drone(path, table, drones)

    def column(name: str) -> npt.NDArray[Any]:
        return np.asarray(table.column(name).to_numpy())[order].reshape(-1, drones)

    arrays: dict[str, npt.NDArray[Any]] = {"time": column("time")[:, 0].copy()}
    for field, group in GROUPS.items():
        parts = [column(name) for name in group]
        joined = np.stack(parts, axis=-1) if len(parts) > 1 else parts[0]
        dtype = np.int64 if field in _INTEGERS else np.bool_ if field in _FLAGS else np.float64
        arrays[field] = np.array(joined, dtype=dtype)
    arrays |= {name: np.array(column(name), dtype=np.float64) for name in terms}
    return arrays, about


def _by_time_and_drone(path: Path, table: Any, drones: int) -> npt.NDArray[np.int64]:
    """Return the order of the rows by time, then by the number of the drone.

    Raises:
        ValueError: a drone has no row, or several, at some time.
    """
    numbers = {f"drone_{i}": i for i in range(drones)}
    number = np.array([numbers.get(name, -1) for name in table.column("drone").to_pylist()])
    time = np.asarray(table.column("time").to_numpy())
    order = np.lexsort((number, time))
    numbered, times = number[order].reshape(-1, drones), time[order].reshape(-1, drones)
    if (numbered != np.arange(drones)).any() or (times != times[:, :1]).any():
        raise ValueError(
            f"{path} must have one row for each of drone_0 to drone_{drones - 1} at each time"
        )
    return np.asarray(order)


def _read_npz(path: Path) -> tuple[Arrays, dict[str, Any]]:
    arrays = read_npz(path)
    _check_names(path, ("about", "time", *GROUPS), arrays)
    about = parse_note(str(arrays.pop("about")))
    _check_names(path, [_TERM + name for name in about["reward_terms"]], arrays)
    return arrays, about


def _check_names(path: Path, expected: Any, found: Any) -> None:
    missing = [name for name in expected if name not in found]
    if missing:
        raise ValueError(f"{path} has no episode: it lacks {', '.join(missing)}")


def _arrow() -> tuple[Any, Any]:
    return pyarrow("a Parquet file", "name the file .npz")
