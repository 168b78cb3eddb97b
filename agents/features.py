"""Features: what a policy network sees of an observation row, easier to learn from than the row.

A row of `swarm_envs.envs.observation` holds everything that a drone senses. A small network learns
faster when it need not find out by itself how near is near, or where two straight ways meet.
There are sets for tasks with goals to be reached (`goal_features`), for tasks with a reference to
be tracked (`reference_features`), and for all that a row can hold (`full_features`). A policy's
file says by name which of them it uses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import kernel
from swarm_envs.envs.observation import Float32Array, observation_layout, observation_width
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

__all__ = [
    "FEATURE_SETS",
    "FULL",
    "GOAL",
    "REFERENCE",
    "TYPED",
    "TYPES",
    "FeatureSizes",
    "goal_features",
]

GOAL = "goal-and-closest-approach-1"
"""Name of `goal_features` in files of policies."""
TYPED = "goal-and-closest-approach-typed-1"
"""The same with the types of vehicles: its own after its own numbers, a neighbour's after its."""
REFERENCE = "reference-and-downwash-1"
"""Name of `reference_features` in files of policies."""
FULL = "full-1"
"""Name of `full_features` in files of policies."""
TYPES = tuple(VEHICLES)
"""Types of vehicles in the order of their one-hot code."""

GOAL_REACH = 0.5  # Beyond this distance the goal's vector is a direction, m
NEAR = 0.4  # Length over which nearness falls by e, m
AHEAD = 2.0  # How far ahead closest approaches are looked for, s
OTHERS_GOAL = 1.0  # A neighbour's way to its goal is seen up to this length, m
OWN_WIDTH, NEIGHBOR_WIDTH = 18, 17
"""Goal features of a drone itself, and of each neighbour, whose mask is the last; types follow."""

REACH = 0.2  # Beyond this distance from the reference its vector is a direction, m
FAST = 0.5  # Unit of errors of velocity, m/s
BESIDE = 0.2  # Length over which downwash falls by e to the side, m
ABOVE = 0.5  # Height at which a neighbour counts as fully above or below, m
REFERENCE_OWN_WIDTH, REFERENCE_NEIGHBOR_WIDTH = 23, 12
"""Reference features of a drone, its type last, and of each neighbour, its type and mask last."""
FULL_OWN_WIDTH, FULL_NEIGHBOR_WIDTH = 31, 25
"""Full features of a drone and of each neighbour, without load, force and obstacles."""
LOAD_WIDTH, FORCE_WIDTH, OBSTACLE_WIDTH = 3, 3, 5
"""Full features of a load, of a predicted force, and of each obstacle."""

_ZERO, _LITTLE, _TWO, _CUT = (np.float32(value) for value in (0.0, 1e-6, 2.0, GOAL_REACH))
_SPEED, _HORIZON = np.float32(SPEED_LIMIT), np.float32(AHEAD)
_REACH, _FOLD = np.float32(OTHERS_GOAL), np.float32(NEAR)


class ObservationColumns(NamedTuple):
    """Where fields begin in a flat observation row, for kernels."""

    position: int
    velocity: int
    attitude: int
    thrust: int
    setpoint_offset: int
    type: int
    goal: int
    time_left: int
    neighbors: int  # Of the nearest neighbour; 0 if none is observed
    neighbor_width: int  # Numbers of a neighbour
    num_neighbors: int  # Neighbours that a row has
    obstacles: int
    """Of the nearest obstacle: three of the offset to it, m, and a mask; 0 if none is observed."""
    num_obstacles: int  # Obstacles that a row has


def observation_columns(fields: Mapping[str, slice]) -> ObservationColumns:
    """Where the fields of a flat observation row begin, of slices by the names of the layout."""
    own = ("position", "velocity", "attitude", "thrust", "setpoint_offset", "type")
    starts = {name: fields[f"self.{name}"].start for name in own}
    starts |= {name: fields[f"task.{name}"].start for name in ("goal", "time_left")}
    nearest = [where for name, where in fields.items() if name.startswith("neighbor_0.")]
    first, width = (nearest[0].start, nearest[-1].stop - nearest[0].start) if nearest else (0, 0)
    count = sum(name.endswith(".mask") and name.startswith("neighbor_") for name in fields)
    starts |= {"neighbors": first, "neighbor_width": width, "num_neighbors": count}
    stands = [where.start for name, where in fields.items() if name.startswith("obstacle_")]
    return ObservationColumns(
        **starts, obstacles=min(stands, default=0), num_obstacles=len(stands) // 2
    )


def goal_features(rows: Float32Array, num_neighbors: int, typed: bool = False) -> Float32Array:
    """Features of flat observation rows without obstacles.

    Of the drone (18): the vector to its goal, over 0.5 m and cut there; its distance, m; velocity
    over 2 m/s; the direction of its thrust, and its share of the largest; the controller's
    set-point relative to the drone, m; position, over 2 m; time left.
    Of each neighbour (17): relative position, m; exp(-d / 0.4 m); relative velocity over 2 m/s; of
    the closest approach, if both fly straight on: the time until then over 2 s, which is as far as
    it is looked for, the relative position then, m, and exp(-distance / 0.4 m); the vector from
    the neighbour to its goal, cut at 1 m; speed at which it comes nearer, over 2 m/s; mask. All
    zero where there is no neighbour. Types are one-hot, `TYPES` in order.

    Args:
        rows: (..., width) as `observation="flat"` gives them, `num_obstacles=0`.
        num_neighbors: K.
        typed: add the drone's own type after its numbers, and each neighbour's after its.

    Returns:
        (..., 18 + 17 K, with types 21 + 20 K) float32.

    Raises:
        ValueError: rows have another width.
    """
    check_width(rows, num_neighbors)
    return _goal_features(rows, _columns(num_neighbors), typed)


def _goal_features(rows: Float32Array, at: ObservationColumns, typed: bool) -> Float32Array:
    """`goal_features` of rows of any form."""
    num_neighbors = at.num_neighbors
    flat = np.ascontiguousarray(rows, np.float32).reshape(-1, rows.shape[-1])
    own, neighbor = (width + typed * len(TYPES) for width in (OWN_WIDTH, NEIGHBOR_WIDTH))
    made: Float32Array = np.empty((len(flat), own + num_neighbors * neighbor), np.float32)
    nearness: Float32Array = np.empty((2, len(flat), num_neighbors), np.float32)
    _write(flat, at, typed, made, nearness)
    if num_neighbors:
        around = made[:, own:].reshape(len(flat), num_neighbors, neighbor)
        np.exp(nearness, out=nearness)
        for where, near in zip(_NEARNESS, nearness, strict=True):
            np.multiply(near, around[..., _MASK], out=around[..., where])
    return made.reshape(*rows.shape[:-1], made.shape[-1])


def check_width(rows: Float32Array, *form: Any) -> None:
    """Refuse rows that are not of a form: K, M, and whether load and force are observed."""
    wanted = observation_width(*form)
    if rows.shape[-1] != wanted:
        num_neighbors, num_obstacles, load, force = (*form, 0, False, False)[:4]
        raise ValueError(
            f"observation rows have {rows.shape[-1]} numbers, but those with num_neighbors="
            f"{num_neighbors} and num_obstacles={num_obstacles} have {wanted}"
            + f" (observe_load={bool(load)}, observe_force={bool(force)})"
            * (load or force)
        )


_NEARNESS, _MASK = (3, 11), 16
"""Where a neighbour's features have nearness, now and at the closest approach, and its mask."""


@kernel
def _write(
    rows: Float32Array,
    at: ObservationColumns,
    typed: bool,
    made: Float32Array,
    nearness: Float32Array,
) -> None:
    """Write the features (R, width) of rows, and the exponents (2, R, K) of nearness, -d / 0.4 m.

    The exponential is left to numpy, whose digits trained policies have seen.
    """
    types = len(TYPES) if typed else 0
    own, width, seen = OWN_WIDTH + types, NEIGHBOR_WIDTH + types, at.neighbor_width
    for r in range(len(rows)):
        _write_own(rows[r], at, types, made[r])
        for j in range(nearness.shape[2]):
            start, end = at.neighbors + j * seen, own + j * width
            near = nearness[:, r, j]
            _write_neighbor(rows[r, start : start + seen], types, made[r, end:], near)


@kernel
def _write_own(row: Float32Array, at: ObservationColumns, types: int, made: Float32Array) -> None:
    """Write the features of the drone itself."""
    square = _ZERO
    for k in range(3):
        square += row[at.goal + k] * row[at.goal + k]
    distance = np.sqrt(square)
    for k in range(3):
        made[k] = row[at.goal + k] / max(distance, _CUT)
        made[4 + k] = row[at.velocity + k]
        made[7 + k] = row[at.attitude + 2 + 3 * k]
        made[11 + k] = row[at.setpoint_offset + k]
        made[14 + k] = row[at.position + k] / _TWO
    made[3], made[10], made[17] = distance, row[at.thrust], row[at.time_left]
    for k in range(types):
        made[OWN_WIDTH + k] = row[at.type + k]


@kernel
def _write_neighbor(
    row: Float32Array, types: int, made: Float32Array, nearness: Float32Array
) -> None:
    """Write the features of a neighbour, of its fields (width,), and the exponents of nearness."""
    mask = row[len(row) - 1]
    square = approach = motion = goal = _ZERO
    for k in range(3):
        velocity = row[3 + k] * _SPEED
        square += row[k] * row[k]
        approach += row[k] * velocity
        motion += velocity * velocity
        goal += row[6 + k] * row[6 + k]
    distance, approach = np.sqrt(square), -approach
    time = min(max(approach / max(motion, _LITTLE), _ZERO), _HORIZON)
    reach, least = max(np.sqrt(goal), _REACH), _ZERO
    for k in range(3):
        closest = row[k] + time * (row[3 + k] * _SPEED)
        least += closest * closest
        made[k] = row[k] * mask
        made[4 + k] = row[3 + k] * mask
        made[8 + k] = closest * mask
        made[12 + k] = row[6 + k] / reach * mask
    nearness[0], nearness[1] = -distance / _FOLD, -np.sqrt(least) / _FOLD
    made[7] = time / _HORIZON * mask
    made[15] = approach / max(distance, _LITTLE) / _SPEED * mask
    made[_MASK] = mask * mask
    for k in range(types):
        made[NEIGHBOR_WIDTH + k] = row[9 + k] * mask


@cache
def _fields(*form: Any) -> Mapping[str, slice]:
    return {field.name: field.where for field in observation_layout(*form)}


@cache
def _columns(*form: Any) -> ObservationColumns:
    return observation_columns(_fields(*form))


def reference_features(rows: Float32Array, num_neighbors: int) -> Float32Array:
    """Features of flat observation rows without obstacles.

    Of the drone (23): the vector to its reference, over 0.2 m and cut there; its distance, m; the
    reference's velocity less its own, over 0.5 m/s; the reference's velocity, m/s, and
    acceleration, m/s^2; the direction of its thrust, and its share of the largest; the controller's
    set-point relative to the reference, over 0.2 m; its type, one-hot.
    Of each neighbour (12): relative position, m, and velocity over 2 m/s; nearness to the vertical
    line through the drone, exp(-h / 0.2 m); this times height above the drone over 0.5 m, cut at
    one; type; mask. All zero where there is no neighbour.

    Args:
        rows: (..., width) as `observation="flat"` gives them, `num_obstacles=0`.
        num_neighbors: K.

    Returns:
        (..., 23 + 12 K) float32.

    Raises:
        ValueError: rows have another width.
    """
    check_width(rows, num_neighbors)
    at = _fields(num_neighbors)
    error = rows[..., at["task.reference_position"]]
    distance = np.linalg.norm(error, axis=-1, keepdims=True)
    velocity = rows[..., at["self.velocity"]] * np.float32(SPEED_LIMIT)
    wanted = rows[..., at["task.reference_velocity"]] * np.float32(SPEED_LIMIT)
    parts: list[npt.NDArray[Any]] = [
        error / np.maximum(distance, REACH),
        distance,
        (wanted - velocity) / np.float32(FAST),
        wanted,
        rows[..., at["task.reference_acceleration"]] * np.float32(ACCELERATION_LIMIT),
        rows[..., at["self.attitude"]][..., 2::3],
        rows[..., at["self.thrust"]],
        (rows[..., at["self.setpoint_offset"]] - error) / np.float32(REACH),
        rows[..., at["self.type"]],
    ]
    parts += [_neighbor_features(rows, at, f"neighbor_{k}") for k in range(num_neighbors)]
    made: Float32Array = np.concatenate(parts, axis=-1, dtype=np.float32)
    return made


def _neighbor_features(rows: Float32Array, at: Mapping[str, slice], name: str) -> Float32Array:
    """(..., 12) of the rows' neighbour of this name."""
    position, mask = rows[..., at[f"{name}.position"]], rows[..., at[f"{name}.mask"]]
    beside = np.exp(-np.linalg.norm(position[..., :2], axis=-1, keepdims=True) / BESIDE)
    above = np.clip(position[..., 2:3] / ABOVE, -1.0, 1.0)
    velocity, kind = rows[..., at[f"{name}.velocity"]], rows[..., at[f"{name}.type"]]
    parts = [position, velocity, beside, beside * above, kind, mask]
    made: Float32Array = np.concatenate(parts, axis=-1, dtype=np.float32) * mask
    return made


def full_features(
    rows: Float32Array,
    num_neighbors: int,
    num_obstacles: int = 0,
    load: bool = False,
    force: bool = False,
) -> Float32Array:
    """Features of all that a flat observation row can hold.

    Positions are relative to the controller's set-point, which is known exactly, also where the
    drone's own position is noisy; `setpoint_offset` says how far the drone is away.

    Of the drone (31): those of `goal_features` and its type; the vector to its reference, over
    0.2 m and cut there; its distance, m; the reference's velocity over 2 m/s, and acceleration over
    5 m/s^2. With load (3): thrust margin, mass ratio and charge; with force (3): the prediction.
    Of each obstacle (5): the vector to it, cut at 1 m; exp(-d / 0.4 m); mask.
    Of each neighbour (25): those of `goal_features` and its type; the vector from the drone's goal
    to the neighbour's, over 2 m and cut there; nearness to the vertical line through the drone and
    this times height, as of `reference_features`; with load (3) its own.

    Args:
        rows: (..., width) as `observation="flat"` gives them.
        num_neighbors: K.
        num_obstacles: M.
        load: whether rows have loads.
        force: whether rows have predicted forces.

    Returns:
        (..., 31 + 3 load + 3 force + 5 M + K (25 + 3 load)) float32.

    Raises:
        ValueError: rows have another width.
    """
    form = num_neighbors, num_obstacles, load, force
    check_width(rows, *form)
    names, columns = _fields(*form), _columns(*form)
    rows = _from_setpoint(rows, columns)
    typed = FEATURE_SETS[TYPED].sizes(num_neighbors)
    own, around = typed.split(_goal_features(rows, columns, True))
    more = [rows[..., names[name]] for name in _EXTRA if name in names]
    error = rows[..., names["task.reference_position"]]
    parts = [own, *_direction(error, REACH), rows[..., names["task.reference_velocity"]]]
    parts += [rows[..., names["task.reference_acceleration"]], *more]
    for k in range(num_obstacles):
        mask = rows[..., names[f"obstacle_{k}.mask"]]
        cut, distance = _direction(rows[..., names[f"obstacle_{k}.offset"]], OTHERS_GOAL)
        parts += [mask * cut, mask * np.exp(-distance / _FOLD), mask]
    if num_neighbors:
        shape = (*rows.shape[:-1], num_neighbors, columns.neighbor_width)
        seen = rows[..., columns.neighbors :][..., : shape[-2] * shape[-1]].reshape(shape)
        goal = rows[..., None, names["task.goal"]]
        members = np.concatenate([around, _beside(seen, goal)], axis=-1)
        parts.append(members.reshape(*rows.shape[:-1], -1))
    made: Float32Array = np.concatenate(parts, axis=-1, dtype=np.float32)
    return made


_EXTRA = ("self.thrust_margin", "self.mass_ratio", "self.battery", "self.force")


def _from_setpoint(rows: Float32Array, at: ObservationColumns) -> Float32Array:
    """The same rows with positions relative to the set-point; a copy."""
    moved: Float32Array = np.array(rows, np.float32)
    offset = rows[..., at.setpoint_offset : at.setpoint_offset + 3]
    moved[..., at.position : at.position + 3] += offset
    moved[..., at.goal : at.goal + 3] -= offset
    moved[..., at.goal + 3 : at.goal + 6] -= offset
    places = [at.neighbors + k * at.neighbor_width for k in range(at.num_neighbors)]
    masks = [start + at.neighbor_width - 1 for start in places]
    starts = [at.obstacles + 4 * k for k in range(at.num_obstacles)]
    for start, mask in zip([*places, *starts], [*masks, *(s + 3 for s in starts)], strict=True):
        moved[..., start : start + 3] -= offset * rows[..., mask, None]
    return moved


def _direction(way: Float32Array, reach: float) -> tuple[Float32Array, Float32Array]:
    """A vector (..., 3) over a length, cut there, and its own length (..., 1), m."""
    distance = np.sqrt(np.square(way).sum(axis=-1, keepdims=True))
    return way / np.maximum(distance, np.float32(reach)), distance


def _beside(seen: Float32Array, goal: Float32Array) -> Float32Array:
    """(..., K, 5 or with load 8) of neighbors (..., K, width) relative to a goal (..., 1, 3)."""
    position, mask = seen[..., 0:3], seen[..., -1:]
    apart, _ = _direction(position + seen[..., 6:9] - goal, 2.0)
    flat = np.sqrt(np.square(position[..., :2]).sum(axis=-1, keepdims=True))
    beside = np.exp(-flat / np.float32(BESIDE))
    above = beside * np.clip(position[..., 2:3] / np.float32(ABOVE), -1.0, 1.0)
    made: Float32Array = np.concatenate([apart, beside, above, seen[..., 9 + len(TYPES) : -1]], -1)
    return made * mask


class FeatureSizes(NamedTuple):
    """Where features of a row have what: the drone's own numbers, then those of K neighbours."""

    num_neighbors: int
    """K"""
    own: int
    """Numbers about the drone itself."""
    neighbor: int
    """Numbers about each neighbour."""
    mask: int
    """Which of a neighbour's says that it is there."""
    own_type: int | None = None
    """Column of its own numbers where its type begins, one-hot, if types are features."""
    neighbor_type: int | None = None
    """The same of a neighbour's numbers."""

    @property
    def typed(self) -> bool:
        """Whether types of vehicles are features."""
        return self.own_type is not None

    @property
    def width(self) -> int:
        """Numbers altogether."""
        return self.own + self.neighbor * self.num_neighbors

    def split(self, values: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Features (..., width) as a drone's (..., own) and its neighbours' (..., K, neighbor)."""
        shape = (*values.shape[:-1], self.num_neighbors, self.neighbor)
        return values[..., : self.own], values[..., self.own :].reshape(shape)


class FeatureSet(NamedTuple):
    """One choice of features."""

    sizes: Callable[..., FeatureSizes]
    """Of features of a row, by the form of the row: K, and for some sets M, load and force."""
    make: Callable[..., Float32Array]  # Features (..., width) of flat rows, and their form


def _full_sizes(
    num_neighbors: int, num_obstacles: int = 0, load: bool = False, force: bool = False
) -> FeatureSizes:
    own = FULL_OWN_WIDTH + LOAD_WIDTH * load + FORCE_WIDTH * force + OBSTACLE_WIDTH * num_obstacles
    neighbor = FULL_NEIGHBOR_WIDTH + LOAD_WIDTH * load
    return FeatureSizes(num_neighbors, own, neighbor, NEIGHBOR_WIDTH - 1, OWN_WIDTH, NEIGHBOR_WIDTH)


def _plain(make: Callable[..., Float32Array], own: int, neighbor: int, *others: int) -> FeatureSet:
    """A set of features that knows no obstacles, loads or forces; its sizes after the K."""

    def check(more: tuple[int, ...]) -> None:
        if any(more):
            raise ValueError(
                f"rows have obstacles, loads or forces {more}, but these features know no "
                f"obstacles, loads or forces; use {FULL!r}"
            )

    def sizes(num_neighbors: int, *more: int) -> FeatureSizes:
        check(more)
        return FeatureSizes(num_neighbors, own, neighbor, *others)

    def made(rows: Float32Array, num_neighbors: int, *more: int) -> Float32Array:
        check(more)
        return make(rows, num_neighbors)

    return FeatureSet(sizes, made)


_TYPED_WIDTHS = OWN_WIDTH + len(TYPES), NEIGHBOR_WIDTH + len(TYPES), NEIGHBOR_WIDTH - 1
_REFERENCE_WIDTHS = REFERENCE_OWN_WIDTH, REFERENCE_NEIGHBOR_WIDTH, REFERENCE_NEIGHBOR_WIDTH - 1
_REFERENCE_TYPES = REFERENCE_OWN_WIDTH - len(TYPES), REFERENCE_NEIGHBOR_WIDTH - 1 - len(TYPES)
FEATURE_SETS: Mapping[str, FeatureSet] = MappingProxyType(
    {
        GOAL: _plain(goal_features, OWN_WIDTH, NEIGHBOR_WIDTH, NEIGHBOR_WIDTH - 1),
        TYPED: _plain(
            partial(goal_features, typed=True), *_TYPED_WIDTHS, OWN_WIDTH, NEIGHBOR_WIDTH
        ),
        REFERENCE: _plain(reference_features, *_REFERENCE_WIDTHS, *_REFERENCE_TYPES),
        FULL: FeatureSet(_full_sizes, full_features),
    }
)
"""By name: files of policies say by it which features their network sees."""
