"""Rows of measured interaction force: one drone at one time, its neighbors, and the label.

The table is the interface between flights (measured or simulated) and the fits. World frame, z up;
SI units, but labels in gram-force as in Neural-Swarm2.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import unknown_name
from swarm_envs.files import read_npz, written_whole
from swarm_envs.state import BoolArray, FloatArray, IntArray

__all__ = ["ROW_ARRAYS", "InteractionRows", "read_rows"]

NO_NEIGHBOR = -1
"""Type of a neighbor slot that is empty."""

FORMAT = "interaction-rows-1"  # Format of the file
_LARGE_VEHICLES = 100  # Ids above this are large vehicles in the logs of the published flights
_PUBLISHED = ("x", "fa", "names", "cf", "flight", "step", "scenario")
_INTEGERS = ("ego_type", "neighbor_type", "flight", "step", "vehicle", "scenario")


Arrays = Mapping[str, npt.NDArray[Any]]  # Arrays of a file by name


@dataclass(frozen=True)
class InteractionRows:
    """R rows with up to K neighbors each; the arrays share their first axis."""

    types: tuple[str, ...]
    """Names of the vehicle types that `ego_type` and `neighbor_type` index."""
    ego_type: IntArray
    """(R,) type of the drone on which the force acts."""
    position: FloatArray
    """(R, 3) its position p_i, m."""
    velocity: FloatArray
    """(R, 3) its velocity v_i, m/s."""
    neighbor: FloatArray
    """(R, K, 6) p_j - p_i (m) and v_j - v_i (m/s) of each neighbor; zeros in empty slots."""
    neighbor_type: IntArray
    """(R, K) type of each neighbor, -1 in empty slots."""
    force_g: FloatArray
    """(R, 3) measured interaction force f_a in gram-force: x, y, z."""
    flight: IntArray
    """(R,) number of the flight."""
    step: IntArray
    """(R,) time step in the flight, in the units of the log."""
    vehicle: IntArray
    """(R,) id of the physical vehicle: rows of one id share its calibration error."""
    scenario: IntArray
    """(R,) index into `scenario_names`."""
    validation: BoolArray
    """(R,) True for rows that are held out of training, in whole blocks of time."""
    scenario_names: tuple[str, ...]
    """Names of the scenarios: `SL2S` is a small drone below a small and a large one."""
    torque: FloatArray | None = None
    """(R, 3) measured interaction torque tau_a, N m, world frame; None if unknown."""
    vehicle_names: dict[int, str] = field(default_factory=dict)
    """Names of vehicles by their id in `vehicle`; a vehicle without a name has its number."""

    def __post_init__(self) -> None:
        if self.neighbor_type.ndim != 2:
            raise ValueError(
                f"neighbor_type has shape {self.neighbor_type.shape}, but must have (R, K): a row "
                "per drone and time, an entry per neighbor"
            )
        count, slots = self.neighbor_type.shape
        shapes = {
            "position": (count, 3),
            "velocity": (count, 3),
            "neighbor": (count, slots, 6),
            "force_g": (count, 3),
        }
        if self.torque is not None:
            shapes["torque"] = (count, 3)
        shapes |= dict.fromkeys(_ROW_VECTORS, (count,))
        for name, shape in shapes.items():
            _check_shape(name, getattr(self, name), shape)
        _check_index("ego_type", self.ego_type, 0, len(self.types))
        _check_index("neighbor_type", self.neighbor_type, NO_NEIGHBOR, len(self.types))
        _check_index("scenario", self.scenario, 0, len(self.scenario_names))

    def __len__(self) -> int:
        return len(self.ego_type)

    @property
    def has_neighbor(self) -> BoolArray:
        """(R, K) True for slots with a neighbor."""
        return np.not_equal(self.neighbor_type, NO_NEIGHBOR)

    def select(self, rows: BoolArray | IntArray) -> InteractionRows:
        """Return only the given rows, by mask or by index."""
        torque = None if self.torque is None else self.torque[rows]
        arrays = {name: getattr(self, name)[rows] for name in ROW_ARRAYS}
        return replace(self, torque=torque, **arrays)

    def with_vertical_force(self, force_z_g: FloatArray) -> InteractionRows:
        """Return the rows with other vertical labels, (R,) in gram-force."""
        force = self.force_g.copy()
        force[:, 2] = force_z_g
        return replace(self, force_g=force)


_ROW_VECTORS = ("ego_type", "flight", "step", "vehicle", "scenario", "validation")
ROW_ARRAYS = ("position", "velocity", "neighbor", "neighbor_type", "force_g", *_ROW_VECTORS)
"""Names of the arrays that have an entry for each row."""


def _check_shape(name: str, array: npt.NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(
            f"{name} has shape {array.shape}, but must have shape {shape}: "
            "one entry per row of neighbor_type, (R, K)"
        )
    if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(
            f"{name} is {array[index]} at index {index}, but every entry must be finite; remove "
            "rows that hold no measurement"
        )


def _check_index(name: str, array: IntArray, low: int, high: int) -> None:
    if array.size and not (low <= array.min() and array.max() < high):
        raise ValueError(
            f"{name} lies in [{array.min()}, {array.max()}], but must lie in [{low}, {high - 1}]"
        )


def save_rows(path: str | os.PathLike[str], rows: InteractionRows) -> None:
    """Write the table as a compressed npz without pickle, atomically; the path ends in `.npz`."""
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(rows, name) for name in ROW_ARRAYS}
    arrays["types"] = np.array(rows.types)
    arrays["scenario_names"] = np.array(rows.scenario_names)
    arrays["vehicle_ids"] = np.array(list(rows.vehicle_names), dtype=np.int64)
    arrays["vehicle_names"] = np.array(list(rows.vehicle_names.values()), dtype=np.str_)
    if rows.torque is not None:
        arrays["torque"] = rows.torque
    arrays["format"] = np.array(FORMAT)
    with written_whole(Path(path)) as partial:
        np.savez_compressed(partial, allow_pickle=False, **arrays)


def read_rows(path: str | os.PathLike[str]) -> InteractionRows:
    """Read rows from a file that `save_rows` wrote, or from the published flights' table.

    Without the array of held-out rows (`validation`, or `val`), no row is held out.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, has neither format, or has invalid values.
    """
    name = os.fspath(path)
    if not Path(path).is_file():
        raise FileNotFoundError(f"no file of interaction rows at {name!r}; give its path")
    try:
        arrays = read_npz(Path(path))
    except (ValueError, OSError) as error:
        raise ValueError(f"it cannot be read ({error}); copy it again or delete it") from error
    if "format" in arrays and str(arrays["format"]) == FORMAT:
        return _saved_rows(arrays)
    if set(_PUBLISHED) <= set(arrays):
        return _published_rows(arrays)
    raise ValueError(
        f"it has the arrays {sorted(arrays)}, which is neither {FORMAT!r} nor the "
        "table of published flights (x, fa, names, cf, val, ...); write it with save_rows"
    )


def _saved_rows(arrays: Arrays) -> InteractionRows:
    missing = [n for n in (*ROW_ARRAYS, "types", "scenario_names") if n not in arrays]
    missing = [name for name in missing if name != "validation"]
    if missing:
        raise ValueError(f"array {missing[0]!r} is missing; there are {', '.join(sorted(arrays))}")
    numbers = {name: _numbers(arrays, name) for name in ROW_ARRAYS if name in arrays}
    count = len(numbers["force_g"]) if numbers["force_g"].ndim else 0
    numbers.setdefault("validation", np.zeros(count, dtype=np.bool_))
    ids, names = (arrays.get(key, np.zeros(0)) for key in ("vehicle_ids", "vehicle_names"))
    return InteractionRows(
        types=tuple(str(name) for name in arrays["types"]),
        scenario_names=tuple(str(name) for name in arrays["scenario_names"]),
        torque=_numbers(arrays, "torque") if "torque" in arrays else None,
        vehicle_names={int(k): str(name) for k, name in zip(ids, names, strict=True)},
        **numbers,
    )


def _numbers(arrays: Arrays, name: str) -> npt.NDArray[Any]:
    """Return an array converted to booleans, integers or float64."""
    array = arrays[name]
    wanted = np.int64 if name in _INTEGERS else np.float64
    allowed = "iub" if name in (*_INTEGERS, "validation") else "iuf"
    if array.dtype.kind not in allowed:
        kind = "integers" if name in _INTEGERS else "numbers"
        raise ValueError(f"{name} has type {array.dtype}, but must have {kind}")
    return array.astype(np.bool_ if name == "validation" else wanted)


def _published_rows(arrays: Arrays) -> InteractionRows:
    """Read the table of the Neural-Swarm authors' flights.

    Columns of `x`: -p and -v of the drone (the environment as a neighbor at the origin), then
    p_j - p_i, v_j - v_i of two neighbors, zeros in empty slots. A scenario's name gives the
    types: `SL2S` is neighbors S and L (in this order), drone S; `Ge` means no neighbor.
    The label is `fa[:, 0:3]`. A row was kept if *any* neighbor is near, so some neighbors are
    outside the interaction volume: they stay in the table, and the models' window masks them.
    """
    x, fa = _numbers(arrays, "x"), _numbers(arrays, "fa")
    if x.ndim != 2 or x.shape[1] != 18 or fa.ndim != 2 or fa.shape[1] < 3:
        raise ValueError(
            f"x has shape {x.shape} and fa {fa.shape}, but they must have (R, 18) and (R, 3) or "
            "(R, 4)"
        )
    names = tuple(str(name) for name in arrays["names"])
    scenario = arrays["scenario"].astype(np.int64)
    if scenario.size and not 0 <= scenario.min() <= scenario.max() < len(names):
        raise ValueError(f"scenario goes to {scenario.max()}, but there are {len(names)} names")
    vehicle = arrays["cf"].astype(np.int64)
    table = np.array([_neighbors(name) for name in names]).reshape(-1, 2)
    return InteractionRows(
        types=("S", "L"),
        ego_type=(vehicle > _LARGE_VEHICLES).astype(np.int64),
        position=-x[:, 0:3],
        velocity=-x[:, 3:6],
        neighbor=x[:, 6:18].reshape(-1, 2, 6),
        neighbor_type=table[scenario].astype(np.int64),
        force_g=fa[:, 0:3],
        flight=arrays["flight"].astype(np.int64),
        step=arrays["step"].astype(np.int64),
        vehicle=vehicle,
        scenario=scenario,
        validation=arrays.get("val", np.zeros(len(x))).astype(np.bool_),
        scenario_names=names,
    )


def _neighbors(scenario: str) -> list[int]:
    """Return the types of the two neighbors of a scenario such as `SL2S`."""
    above, _, ego = scenario.partition("2")
    above = "" if above == "Ge" else above
    for letter in (*above, ego):
        if letter not in ("S", "L"):
            where = f"in the scenario {scenario!r}"
            raise ValueError(unknown_name("vehicle type", letter, ("S", "L"), where))
    if len(above) > 2:
        raise ValueError(f"scenario {scenario!r} has {len(above)} neighbors, but x has two")
    return [*(("S", "L").index(letter) for letter in above), *[NO_NEIGHBOR] * (2 - len(above))]
