"""Lifelong planning: a robot that reaches its goal gets the next one, step by step with PIBT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import (
    Coordinates,
    GridInstance,
    check_instance,
    check_places,
    points,
)
from swarm_envs.baselines.rth3d.grid_validation import check_paths
from swarm_envs.baselines.rth3d.pibt import NO_LIMIT, Pibt
from swarm_envs.errors import check_integer


@dataclass(frozen=True, eq=False)
class LifelongPlan:
    """Paths of robots to sequences of goals."""

    paths: npt.NDArray[np.int16]
    """(T + 1, n, 3) vertex (x, y, z) of each robot after each step."""
    reached: npt.NDArray[np.int32]
    """(n,) goals that each robot has reached."""

    @property
    def throughput(self) -> float:
        """The mean number of goals that all robots together reach per step, of those planned."""
        return float(self.reached.sum()) / max(len(self.paths) - 1, 1)


def plan_lifelong(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    steps: int,
    obstacles: npt.ArrayLike | None = None,
    seed: int = 0,
) -> LifelongPlan:
    """Plan paths of robots that each have a sequence of goals.

    PIBT plans each step with the present goals alone (Okumura et al., AIJ 2022), so that those to
    come need not be known. A robot at its last goal stays there, and makes room for others.

    Args:
        starts: (n, 3) integers, all different: the vertices (x, y, z) that the robots start at.
        goals: (n, K, 3) integers: the goals of each robot, in their order. Robots may share them.
            Give a robot with fewer goals its last one again; each of them counts.
        shape: (m1, m2, m3) of the grid, or (m1, m2) with (n, 2) starts and (n, K, 2) goals.
        steps: the maximum number of steps; fewer if all robots reach their last goals before.
        obstacles: booleans of that shape, True anywhere, or None.
        seed: of PIBT's choices.

    Returns:
        The paths, and how many of its goals each robot has reached.

    Raises:
        ValueError: starts, goals or obstacles are not as they must be; the message says why.
        NoPlanExists: obstacles cut a robot off from a goal.
    """
    check_integer("steps", steps, at_least=1, at_most=1_000_000)
    check_integer("seed", seed, at_least=0)
    instance = check_instance(starts, starts, shape, obstacles)
    targets = _checked_goals(goals, instance)
    pibt = Pibt(replace(instance, goals=targets[:, 0]), steps)
    pibt.shuffle(np.random.default_rng(seed))
    reached, last = np.zeros(len(targets), dtype=np.int32), 0
    while True:
        _give_next(pibt, targets, reached, points(pibt.paths[last], instance.shape))
        if last == steps or (reached == targets.shape[1]).all():
            return _checked(instance, pibt.paths[: last + 1], reached)
        last, _ = pibt.run(last, last + 1, NO_LIMIT, -1, False)


def _checked_goals(goals: npt.ArrayLike, instance: GridInstance) -> npt.NDArray[np.int32]:
    given, count = np.asarray(goals), len(instance.starts)
    if given.ndim != 3 or given.shape[0] != count or given.shape[1] == 0:
        raise ValueError(f"goals have shape {given.shape}, but must be ({count}, K, 3), K > 0")
    facts = (instance.shape, instance.obstacles)
    found = np.stack([check_places(f"goals[{i}]", own, *facts) for i, own in enumerate(given)])
    for turn in found.swapaxes(0, 1):
        _ = replace(instance, goals=turn).lengths  # raises NoPlanExists
    return found


def _give_next(
    pibt: Pibt,
    goals: npt.NDArray[np.int32],
    reached: npt.NDArray[np.int32],
    at: Coordinates,
) -> None:
    """Count the goals that robots are at, in `reached`, and give them the next ones."""
    waiting = np.flatnonzero(reached < goals.shape[1])
    arrived = waiting[(at[waiting] == goals[waiting, reached[waiting]]).all(axis=1)]
    reached[arrived] += 1
    onward = arrived[reached[arrived] < goals.shape[1]]
    if len(onward):
        pibt.aim(onward, goals[onward, reached[onward]])


def _checked(instance: GridInstance, paths: Paths, reached: npt.NDArray[np.int32]) -> LifelongPlan:
    ends = replace(instance, goals=points(paths[-1], instance.shape))
    report, _ = check_paths(paths, ends)
    if not report:
        raise AssertionError(f"PIBT has made an invalid plan: {report.reason}")
    return LifelongPlan(points(paths, instance.shape).astype(np.int16), reached)
