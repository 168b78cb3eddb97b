"""Lifelong planning: a robot that reaches its goal gets the next one, step by step with PIBT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import Range, Seed, typed
from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance, check_vertices, points
from swarm_envs.baselines.rth3d.grid_validation import check_paths
from swarm_envs.baselines.rth3d.pibt import Pibt


@dataclass(frozen=True, eq=False)
class LifelongPlan:
    """Paths of robots to goals after goals."""

    paths: npt.NDArray[np.int16]
    """(T + 1, n, 3) vertex (x, y, z) of each robot after each step."""
    reached: npt.NDArray[np.int32]
    """(n,) goals that each robot has reached."""

    @property
    def throughput(self) -> float:
        """Goals that are reached in a step, by all robots together."""
        return float(self.reached.sum()) / max(len(self.paths) - 1, 1)


@typed
def plan_lifelong(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    steps: Annotated[int, Range(1, 1_000_000)],
    obstacles: npt.ArrayLike | None = None,
    seed: Seed = 0,
) -> LifelongPlan:
    """Plan paths of robots that each have goals one after the other.

    PIBT plans each step with the present goals alone (Okumura et al., AIJ 2022), so that those to
    come need not be known. A robot at its last goal stays there, and makes room for others.

    Args:
        starts: (n, 3) integers, all different: the vertices (x, y, z) that the robots start at.
        goals: (n, K, 3) integers: the goals of each robot, in their order. Robots may share them.
        shape: (m1, m2, m3) of the grid.
        steps: to plan at most; fewer if all have reached their last goals before.
        obstacles: booleans of that shape, True anywhere, or None.
        seed: of PIBT's choices.

    Raises:
        ValueError: starts, goals or obstacles are not as they must be; the message says why.
        NoPlanExists: obstacles cut a robot off from a goal.
    """
    instance = check_instance(starts, starts, shape, obstacles)
    targets, count = np.asarray(goals), len(instance.starts)
    if targets.ndim != 3 or targets.shape[0] != count or targets.shape[1] == 0:
        raise ValueError(f"goals have shape {targets.shape}, but must be ({count}, K, 3), K > 0")
    check_vertices(
        "goals", np.unique(targets.reshape(-1, 3), axis=0), instance.shape, instance.obstacles
    )
    turns = [replace(instance, goals=found) for found in targets.swapaxes(0, 1).astype(np.int32)]
    for turn in turns:
        _ = turn.lengths  # raises NoPlanExists
    pibt, reached = Pibt(turns[0], steps), np.zeros(count, dtype=np.int32)
    pibt.shuffle(np.random.default_rng(seed))
    last, limit = 0, 2 * steps + sum(instance.shape)
    while True:
        at = points(pibt.paths[last], instance.shape)
        left = np.flatnonzero(reached < len(turns))
        arrived = left[(at[left] == targets[left, reached[left]]).all(axis=1)]
        reached[arrived] += 1
        onward = arrived[reached[arrived] < len(turns)]
        if len(onward):
            pibt.aim(onward, targets[onward, reached[onward]])
        if last == steps or (reached == len(turns)).all():
            break
        last, _ = pibt.run(last, last + 1, limit, -1, False)
    return _checked(instance, pibt.paths[: last + 1], reached)


def _checked(instance: GridInstance, paths: Paths, reached: npt.NDArray[np.int32]) -> LifelongPlan:
    ends = replace(instance, goals=points(paths[-1], instance.shape))
    report, _ = check_paths(paths, ends)
    if not report:
        raise AssertionError(f"PIBT has made an invalid plan: {report.reason}")
    return LifelongPlan(points(paths, instance.shape).astype(np.int16), reached)
