"""Rows of measured interaction force: one drone at one time, its neighbours, and the label.

The table is the one interface between flights (measured ones, or ours) and everything that is
fitted to them. World frame, z up; SI, but labels in gram-force, as Neural-Swarm2 gives them.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.files import written_whole

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

NO_NEIGHBOR = -1
"""Type of a neighbour slot that is empty."""

_LARGE_VEHICLES = 100  # vehicle ids from here on are large in the logs of the published flights


@dataclass(frozen=True)
class InteractionRows:
    """R rows with up to K neighbours each; the arrays share their first axis."""

    types: tuple[str, ...]
    """Names of the vehicle types that `ego_type` and `neighbor_type` index."""
    ego_type: IntArray
    """(R,) type of the drone that feels the force."""
    position: FloatArray
    """(R, 3) its position p_i, m."""
    velocity: FloatArray
    """(R, 3) its velocity v_i, m/s."""
    neighbor: FloatArray
    """(R, K, 6) p_j - p_i (m) and v_j - v_i (m/s) of each neighbour; zeros in empty slots."""
    neighbor_type: IntArray
    """(R, K) type of each neighbour, -1 where there is none."""
    force_g: FloatArray
    """(R, 3) measured interaction force f_a in gram-force: x, y, z."""
    flight: IntArray
    """(R,) which flight the row comes from."""
    step: IntArray
    """(R,) time step in the flight, in the units of the log."""
    vehicle: IntArray
    """(R,) id of the physical vehicle: rows of one id share its calibration error."""
    scenario: IntArray
    """(R,) index into `scenario_names`."""
    validation: BoolArray
    """(R,) held out of training. Whole blocks of time, since neighbouring rows are near copies."""
    scenario_names: tuple[str, ...]
    """Names of the scenarios: `SL2S` is a small drone under a small and a large one."""

    def __post_init__(self) -> None:
        """Check that the arrays fit together.

        Raises:
            ValueError: an array has a wrong shape, an index is out of range, or a value is not
                finite.
        """
        count, slots = self.neighbor_type.shape
        shapes = {
            "position": (count, 3),
            "velocity": (count, 3),
            "neighbor": (count, slots, 6),
            "force_g": (count, 3),
        }
        shapes |= dict.fromkeys(_ROW_VECTORS, (count,))
        for name, shape in shapes.items():
            _check_shape(name, getattr(self, name), shape)
        _check_index("ego_type", self.ego_type, 0, len(self.types))
        _check_index("neighbor_type", self.neighbor_type, NO_NEIGHBOR, len(self.types))
        _check_index("scenario", self.scenario, 0, len(self.scenario_names))

    def __len__(self) -> int:
        """Number of rows R."""
        return len(self.ego_type)

    @property
    def has_neighbor(self) -> BoolArray:
        """(R, K) whether the slot holds a neighbour."""
        return np.not_equal(self.neighbor_type, NO_NEIGHBOR)

    def select(self, rows: BoolArray | IntArray) -> InteractionRows:
        """Return only the given rows, by mask or by index."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _ARRAYS})

    def with_vertical_force(self, force_z_g: FloatArray) -> InteractionRows:
        """Return the same rows with another vertical label, (R,) in gram-force."""
        force = self.force_g.copy()
        force[:, 2] = force_z_g
        return replace(self, force_g=force)


_ROW_VECTORS = ("ego_type", "flight", "step", "vehicle", "scenario", "validation")
_ARRAYS = ("position", "velocity", "neighbor", "neighbor_type", "force_g", *_ROW_VECTORS)
_FORMAT = "interaction-rows-1"


def _check_shape(name: str, array: npt.NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(
            f"{name} has shape {array.shape}, but must have shape {shape}: "
            "one entry per row of neighbor_type"
        )
    if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is {array[index]} at index {index}; every entry must be finite")


def _check_index(name: str, array: IntArray, low: int, high: int) -> None:
    if array.size and not (low <= array.min() and array.max() < high):
        raise ValueError(
            f"{name} lies in [{array.min()}, {array.max()}], but must lie in [{low}, {high - 1}]"
        )


def save_rows(path: str | os.PathLike[str], rows: InteractionRows) -> None:
    """Write the table as a compressed npz without pickle, atomically.

    Args:
        path: the file to write, ending in `.npz`.
        rows: what to write.
    """
    target = Path(path)
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(rows, name) for name in _ARRAYS}
    arrays["types"] = np.array(rows.types)
    arrays["scenario_names"] = np.array(rows.scenario_names)
    arrays["format"] = np.array(_FORMAT)
    with written_whole(target) as partial:
        np.savez_compressed(partial, allow_pickle=False, **arrays)


def read_rows(path: str | os.PathLike[str]) -> InteractionRows:
    """Read rows from a file that `save_rows` wrote, or from the published flights' table.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file has neither format.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(
            f"no file of interaction rows at {os.fspath(path)!r}; give its path"
        )
    with np.load(path, allow_pickle=False) as file:
        if "format" in file and str(file["format"]) == _FORMAT:
            return _saved_rows({name: file[name] for name in file.files})
        if {"x", "fa", "names", "cf", "val"} <= set(file.files):
            return _published_rows({name: file[name] for name in file.files})
        raise ValueError(
            f"{os.fspath(path)!r} holds {sorted(file.files)}, which is neither {_FORMAT!r} nor the "
            "table of published flights (x, fa, names, cf, val, ...); write it with save_rows"
        )


def _saved_rows(arrays: dict[str, npt.NDArray[np.generic]]) -> InteractionRows:
    return InteractionRows(
        types=tuple(str(name) for name in arrays["types"]),
        scenario_names=tuple(str(name) for name in arrays["scenario_names"]),
        **{name: arrays[name] for name in _ARRAYS},  # type: ignore[arg-type]
    )


def _published_rows(arrays: dict[str, npt.NDArray[np.generic]]) -> InteractionRows:
    """Read the table of the Neural-Swarm authors' flights.

    Columns of `x`: -p and -v of the drone (the environment as a neighbour at the origin), then
    p_j - p_i, v_j - v_i of two neighbours, zeros where there is none. A scenario's name gives the
    types: `SL2S` is neighbours S and L (in this order), drone S; `Ge` means no neighbour.
    The label is `fa[:, 0:3]`. A row was kept if *any* neighbour is near, so some neighbours stand
    outside the interaction volume: they stay in the table, and the models' window masks them.
    """
    x = arrays["x"].astype(np.float64)
    names = tuple(str(name) for name in arrays["names"])
    scenario = arrays["scenario"].astype(np.int64)
    types = ("S", "L")
    table = np.full((len(names), 2), NO_NEIGHBOR)
    for index, name in enumerate(names):
        above = name.split("2")[0]
        if above != "Ge":
            table[index, : len(above)] = [types.index(letter) for letter in above]
    vehicle = arrays["cf"].astype(np.int64)
    return InteractionRows(
        types=types,
        ego_type=(vehicle > _LARGE_VEHICLES).astype(np.int64),
        position=-x[:, 0:3],
        velocity=-x[:, 3:6],
        neighbor=x[:, 6:18].reshape(-1, 2, 6),
        neighbor_type=table[scenario].astype(np.int64),
        force_g=arrays["fa"][:, 0:3].astype(np.float64),
        flight=arrays["flight"].astype(np.int64),
        step=arrays["step"].astype(np.int64),
        vehicle=vehicle,
        scenario=scenario,
        validation=arrays["val"].astype(np.bool_),
        scenario_names=names,
    )
