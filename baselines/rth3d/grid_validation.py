"""The validation of grid plans, step by step, by code that planners do not use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import (
    Array,
    Coordinates,
    GridInstance,
    Shape,
    Vertices,
    check_instance,
    numbers,
    points,
)
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray

MOVES = np.array([*np.kron(np.eye(3), [[-1], [1]]), np.zeros(3)], dtype=np.int8)
"""The step (7, 3) along x, y and z of each number in a plan's `moves`."""
_REASONS = (
    "",
    "does not begin at its start",
    "does not end at its goal",
    "leaves the grid",
    "moves by more than one edge",
    "is on an obstacle",
    "is on the vertex of another robot",
    "swaps places with another robot",
)


@dataclass(frozen=True, kw_only=True)
class ValidationReport:
    """The result of validating a plan."""

    ok: bool  # True if the plan is feasible (Sec. II-A)
    # A broken rule with robot and time, from the ends or else the first such step; empty if the
    # plan is feasible
    reason: str
    time: int | None = None  # The time step at which the rule is broken
    robot: int | None = None  # The robot that breaks it
    makespan: int = 0  # The last step in which any robot moves
    sum_of_costs: int = 0  # The sum over robots of the last step in which each moves
    moves: int = 0  # The number of moves along edges, of all robots

    def __bool__(self) -> bool:
        return self.ok


@kernel
def follow_paths(
    paths: Array, open_edges: Array, deltas: Array, arrived: Array, last: Array, moves: Array
) -> tuple[int, int]:
    """Follow all paths; return the first step in which a rule is broken or 0, and the moves.

    Args:
        paths: The vertices (T + 1, n).
        open_edges: (V,) with bit k set if edge k of a vertex leads to a free vertex.
        deltas: The differences (7,) of vertices' numbers along each edge, and 0 for a wait.
        arrived: (V,) zeros, overwritten by 8 times the last arrival at a vertex plus its edge.
        last: (n,) zeros, overwritten by the last step in which each robot moves.
        moves: (T, n), overwritten by the edge of each move, 6 for a wait.
    """
    steps, count = paths.shape
    moved = 0
    for t in range(1, steps):
        for i in range(count):
            before, now = paths[t - 1, i], paths[t, i]
            edge = 6
            if now != before:
                edge = 0
                while edge < 6 and deltas[edge] != now - before:
                    edge += 1
                if edge == 6 or not open_edges[before] >> edge & 1:
                    return t, moved
                last[i] = t
                moved += 1
            if arrived[now] >> 3 == t:
                return t, moved
            arrived[now] = t << 3 | edge
            moves[t - 1, i] = edge
        for i in range(count):
            before, now = paths[t - 1, i], paths[t, i]
            other = arrived[before]
            if before != now and other >> 3 == t and deltas[other & 7] == before - now:
                return t, moved
    return 0, moved


def _open_edges(obstacles: BoolArray) -> npt.NDArray[np.uint8]:
    """Return the edges of each vertex (V,) that lead to a free one, as bits for `follow_paths`."""
    free: BoolArray = np.pad(~obstacles, 1, constant_values=False)
    found = np.zeros(obstacles.shape, dtype=np.uint8)
    for edge, step in enumerate(MOVES[:6].tolist()):
        there = np.roll(free, [-k for k in step], axis=(0, 1, 2))[1:-1, 1:-1, 1:-1]
        found |= there.astype(np.uint8) << edge
    return found.ravel()


def _fault(before: Coordinates, now: Coordinates, obstacles: BoolArray) -> tuple[int, int]:
    """Return the rule that an invalid step breaks, and the robot that breaks it."""
    sides = np.array(obstacles.shape)
    lengths = np.abs(now - before).sum(axis=1)
    outside = np.logical_or(now < 0, now >= sides).any(axis=1)
    inside = np.where(outside, 0, now.T)
    at = {tuple(place): i for i, place in enumerate(before.tolist())}
    who = np.array([at.get(tuple(place), -1) for place in now.tolist()])
    swaps = (who >= 0) & (now[who] == before).all(axis=1)
    rules = np.select([outside, obstacles[tuple(inside)], lengths > 1, swaps], [3, 5, 4, 7], 0)
    rules[lengths == 0] = 0
    if rules.any():
        robot = int(rules.nonzero()[0][0])
        return int(rules[robot]), robot
    taken = set(map(tuple, now[lengths == 0].tolist()))
    for robot in np.flatnonzero(lengths).tolist():
        place = tuple(now[robot].tolist())
        if place in taken:
            return 6, robot
        taken.add(place)
    raise AssertionError("no rule is broken in this step")


def check_paths(
    paths: Paths, instance: GridInstance
) -> tuple[ValidationReport, npt.NDArray[np.int8]]:
    """Return a report on paths (T + 1, n) of vertices, -1 outside the grid, and moves (T, n)."""
    starts, goals = (numbers(p, instance.shape) for p in (instance.starts, instance.goals))
    count = paths.shape[1]
    last, moves = np.zeros(count, dtype=np.int32), np.empty((len(paths) - 1, count), dtype=np.int8)
    for rule, step, ends in ((1, 0, starts), (2, len(paths) - 1, goals)):
        wrong = paths[step] != ends
        if wrong.any():
            return _broken(rule, int(wrong.argmax()), step), moves
    _, m2, m3 = instance.shape
    deltas = MOVES @ np.array([m2 * m3, m3, 1], dtype=np.int32)
    arrived = np.zeros(instance.obstacles.size, dtype=np.int32)
    step, moved = follow_paths(paths, _open_edges(instance.obstacles), deltas, arrived, last, moves)
    if step:
        before, now = (_places(paths[t], instance.shape) for t in (step - 1, step))
        return _broken(*_fault(before, now, instance.obstacles), step), moves
    costs = {"makespan": int(last.max()), "sum_of_costs": int(last.sum(dtype=np.int64))}
    return ValidationReport(ok=True, reason="", moves=moved, **costs), moves


def as_vertices(paths: npt.NDArray[np.integer], shape: Shape) -> Paths:
    """Return the vertices (T + 1, n) of paths (T + 1, n, 3), with -1 for those outside the grid."""
    found = np.empty(paths.shape[:2], dtype=np.int32)
    for vertices, places in zip(found, paths, strict=True):
        inside = ((places >= 0) & (places < shape)).all(axis=1)
        vertices[:] = np.where(inside, numbers(places, shape), -1)
    return found


def _places(vertices: Vertices, shape: Shape) -> Coordinates:
    """Return the coordinates (n, 3) of vertices, -1 for a vertex outside the grid."""
    return np.where(vertices[:, None] < 0, -1, points(np.maximum(vertices, 0), shape))


def _broken(rule: int, robot: int, step: int) -> ValidationReport:
    reason = f"robot {robot} {_REASONS[rule]} at time {step}"
    return ValidationReport(ok=False, reason=reason, time=step, robot=robot)


def validate(
    paths: npt.ArrayLike,
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    obstacles: npt.ArrayLike | None = None,
) -> ValidationReport:
    """Return a report on the feasibility of a plan (Sec. II-A).

    Every robot begins at its start and ends at its goal. Each step is a wait or a move along one
    edge of the grid. No robot is on an obstacle or on another's vertex, or swaps with another. A
    robot may enter a vertex that another leaves in the same step, also in rings of three or more.

    Args:
        paths: The vertex (T + 1, n, 3) of each robot after each step, integers.
        starts: The start vertices (n, 3), integers.
        goals: The goal vertices (n, 3), integers.
        shape: The shape of the grid.
        obstacles: Booleans of that shape, anywhere, or None.

    Returns:
        A report that is true if the plan is feasible, and else has the broken rule.

    Raises:
        ValueError: The instance is invalid, or `paths` is no such array.
    """
    instance = check_instance(starts, goals, shape, obstacles)
    given = np.asarray(paths)
    if given.ndim != 3 or given.shape[1:] != instance.starts.shape or len(given) == 0:
        expected = f"(T + 1, {len(instance.starts)}, 3) for these starts"
        raise ValueError(f"paths have shape {given.shape}, but must have {expected}")
    if not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"paths are of type {given.dtype}, but must be integers")
    return check_paths(as_vertices(given, instance.shape), instance)[0]
