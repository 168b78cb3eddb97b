"""Whether a grid plan is one: checked step by step, by other code than the planners'."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.baselines.rth3d.grid import Array, check_instance
from swarm_envs.compiled import kernel

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
    """What `validate` found."""

    ok: bool  # Whether the plan is feasible (Sec. II-A).
    reason: str  # Which rule is broken first, by whom and when; empty if none is
    time: int | None = None  # Step after which it is broken
    robot: int | None = None  # Who breaks it
    makespan: int = 0  # Last step in which anyone moves
    sum_of_costs: int = 0  # Sum over the robots of the last step in which each moves
    moves: int = 0  # Moves along edges, of all robots

    def __bool__(self) -> bool:
        return self.ok


@kernel
def follow_paths(
    paths: Array, starts: Array, goals: Array, holder: Array, last: Array, movers: Array
) -> tuple[int, int, int, int]:
    """Walk all paths; return (broken rule or 0, time, robot, moves).

    `holder` says who is on each vertex: -1 for nobody, -2 for an obstacle. Who waits stays in it:
    only movers (n,) are looked at.
    """
    steps, count, _ = paths.shape
    for i in range(count):
        for k in range(3):
            if paths[0, i, k] != starts[i, k]:
                return 1, 0, i, 0
            if paths[steps - 1, i, k] != goals[i, k]:
                return 2, steps - 1, i, 0
        holder[paths[0, i, 0], paths[0, i, 1], paths[0, i, 2]] = i
    moves = 0
    for t in range(1, steps):
        rule, i, moving = _leave(paths[t - 1], paths[t], holder, movers)
        for k in range(moving):
            if rule:
                break
            i = movers[k]
            x, y, z = paths[t, i, 0], paths[t, i, 1], paths[t, i, 2]
            rule = 6 if holder[x, y, z] >= 0 else 0
            holder[x, y, z] = i
            last[i] = t
        if rule:
            return rule, t, i, moves
        moves += moving
    return 0, 0, 0, moves


@kernel
def _leave(before: Array, now: Array, holder: Array, movers: Array) -> tuple[int, int, int]:
    """Check every move, and take the movers off the grid; return (broken rule or 0, robot, moves).

    Whether two movers meet is not seen here.
    """
    moving = 0
    for i in range(now.shape[0]):
        length = 0
        for k in range(3):
            length += abs(now[i, k] - before[i, k])
        if length == 0:
            continue
        for k in range(3):
            if now[i, k] < 0 or now[i, k] >= holder.shape[k]:
                return 3, i, moving
        other = holder[now[i, 0], now[i, 1], now[i, 2]]
        if other == -2:
            return 5, i, moving
        if length > 1:
            return 4, i, moving
        if other >= 0:
            same = True
            for k in range(3):
                same = same and now[other, k] == before[i, k]
            if same:
                return 7, i, moving
        movers[moving] = i
        moving += 1
    for k in range(moving):
        i = movers[k]
        holder[before[i, 0], before[i, 1], before[i, 2]] = -1
    return 0, 0, moving


@typed
def validate(
    paths: npt.ArrayLike,
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    obstacles: npt.ArrayLike | None = None,
    labels: bool = True,
) -> ValidationReport:
    """Check a plan against the definition of a feasible one (Sec. II-A).

    Everyone begins at its start and ends at its goal; each step is a wait or a move along one edge
    of the grid; nobody is on an obstacle, or on another's vertex, or swaps with another. To follow,
    into a vertex that is left in the same step, is allowed, in rings of three or more too.

    Args:
        paths: (T + 1, n, 3) integers: where each robot is after each step.
        starts: (n, 3) integers.
        goals: (n, 3) integers.
        shape: of the grid.
        obstacles: booleans of that shape, anywhere, or None.
        labels: whether each robot must end at its own goal; else all goals must be taken.

    Returns:
        A report that is true if the plan is feasible, and otherwise says what is wrong.

    Raises:
        ValueError: the instance itself is none, or paths are no such array.
    """
    instance = check_instance(starts, goals, shape, obstacles)
    given = np.asarray(paths)
    if given.ndim != 3 or given.shape[1:] != instance.starts.shape or len(given) == 0:
        wanted = f"(T + 1, {len(instance.starts)}, 3) for these starts"
        raise ValueError(f"paths have shape {given.shape}, but must have {wanted}")
    if not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"paths are of type {given.dtype}, but must be integers")
    if given.dtype != np.int16:
        wide = np.clip(given, -1, 32767)  # what is outside stays outside
        given = wide.astype(np.int16)
    goals_of = instance.goals
    if not labels:
        wanted_ends = set(map(tuple, instance.goals.tolist()))
        reached = [tuple(end) in wanted_ends for end in given[-1].tolist()]
        goals_of = np.where(np.array(reached)[:, None], given[-1], -1).astype(np.int32)
    last = np.zeros(given.shape[1], dtype=np.int64)
    holder = np.where(instance.obstacles, np.int32(-2), np.int32(-1))
    rule, step, robot, moves = follow_paths(
        np.ascontiguousarray(given),
        instance.starts,
        goals_of,
        holder,
        last,
        np.empty(given.shape[1], dtype=np.int32),
    )
    if rule:
        reason = f"robot {robot} {_REASONS[rule]} at time {step}"
        return ValidationReport(ok=False, reason=reason, time=int(step), robot=int(robot))
    return ValidationReport(
        ok=True,
        reason="",
        makespan=int(last.max()),
        sum_of_costs=int(last.sum()),
        moves=int(moves),
    )
