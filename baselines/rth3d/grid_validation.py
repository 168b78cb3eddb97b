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

    ok: bool
    """Whether the plan is feasible (Sec. II-A)."""
    reason: str
    """Which rule is broken first, by whom and when; empty if none is."""
    time: int | None = None
    """Step after which it is broken."""
    robot: int | None = None
    """Who breaks it."""
    makespan: int = 0
    """Last step in which anyone moves."""
    sum_of_costs: int = 0
    """Sum over the robots of the last step in which each moves."""
    moves: int = 0
    """Moves along edges, of all robots."""

    def __bool__(self) -> bool:
        return self.ok


@kernel
def follow_paths(
    paths: Array, starts: Array, goals: Array, blocked: Array, holder: Array, last: Array
) -> tuple[int, int, int, int]:
    """Walk all paths; return (broken rule or 0, time, robot, moves)."""
    steps, count, _ = paths.shape
    for i in range(count):
        for k in range(3):
            if paths[0, i, k] != starts[i, k]:
                return 1, 0, i, 0
            if paths[steps - 1, i, k] != goals[i, k]:
                return 2, steps - 1, i, 0
    moves = 0
    for t in range(steps):
        rule, i = _enter(paths[t], blocked, holder)
        if rule:
            return rule, t, i, moves
        if t:
            for i in range(count):
                rule = _step(paths[t - 1], paths[t], holder, i)
                if rule > 0:
                    return rule, t, i, moves
                if rule < 0:
                    moves += 1
                    last[i] = t
        for i in range(count):
            holder[paths[t, i, 0], paths[t, i, 1], paths[t, i, 2]] = -1
    return 0, 0, 0, moves


@kernel
def _enter(now: Array, blocked: Array, holder: Array) -> tuple[int, int]:
    """Put everyone on the grid; return (broken rule or 0, robot)."""
    for i in range(now.shape[0]):
        x, y, z = now[i, 0], now[i, 1], now[i, 2]
        for k in range(3):
            if now[i, k] < 0 or now[i, k] >= blocked.shape[k]:
                return 3, i
        if blocked[x, y, z]:
            return 5, i
        if holder[x, y, z] >= 0:
            return 6, i
        holder[x, y, z] = i
    return 0, 0


@kernel
def _step(before: Array, now: Array, holder: Array, i: int) -> int:
    """0 if robot i waits, -1 if it moves along an edge, else the rule that it breaks."""
    length = 0
    for k in range(3):
        length += abs(now[i, k] - before[i, k])
    if length == 0:
        return 0
    if length > 1:
        return 4
    other = holder[before[i, 0], before[i, 1], before[i, 2]]
    if other >= 0:
        same = True
        for k in range(3):
            same = same and before[other, k] == now[i, k]
        if same:
            return 7
    return -1


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
        labels: whether each robot must end at its own goal, or all at goals, whoever at which.

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
    holder = np.full(instance.shape, -1, dtype=np.int32)
    rule, step, robot, moves = follow_paths(
        np.ascontiguousarray(given),
        instance.starts,
        goals_of,
        instance.obstacles,
        holder,
        last,
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
