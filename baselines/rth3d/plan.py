"""`plan`: labelled robots on a grid, from where they are to where they must be."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.baselines.rth3d.grid import (
    Coordinates,
    GridInstance,
    Shape,
    check_instance,
    check_pattern,
    numbers,
    points,
)
from swarm_envs.baselines.rth3d.records import Clock, PhaseRecord
from swarm_envs.baselines.rth3d.solvers import METHODS, Solution
from swarm_envs.baselines.rth3d.validation import ValidationReport, follow_paths, validate
from swarm_envs.compiled import announce_compilation
from swarm_envs.errors import check_integer, check_name
from swarm_envs.state import BoolArray


@dataclass(frozen=True, eq=False, kw_only=True)
class GridPlan:
    """Paths of all robots, and what they are worth."""

    paths: npt.NDArray[np.int16]
    """(T + 1, n, 3) vertex (x, y, z) of each robot after each step; T is the makespan."""
    starts: Coordinates
    """(n, 3)."""
    goals: Coordinates
    """(n, 3)."""
    shape: Shape
    """(m1, m2, m3)."""
    obstacles: BoolArray
    """(m1, m2, m3)."""
    method: str
    """What was asked for."""
    winner: str
    """What the paths are by: of `auto`, "pibt", "rth3d-lba" or "pibt, then rth3d-lba"."""
    seed: int
    """Of the planner."""
    lower_bound: int
    """Largest Manhattan distance of a robot to its goal: no plan is shorter."""
    bound: int | None
    """What the makespan is guaranteed not to exceed, given the steps of balancing; None for PIBT,
    which has none."""
    before_compaction: int | None
    """Makespan of RTH3D's phases one after another; None if the paths are not by it alone."""
    phases: tuple[PhaseRecord, ...]
    """Every phase of planning, with its makespan and its seconds."""
    valid: bool
    """Whether `validate` has found the paths feasible; `plan` returns no others."""

    @property
    def makespan(self) -> int:
        """Steps until the last robot is at its goal."""
        return len(self.paths) - 1

    @property
    def ratio(self) -> float:
        """Makespan over lower bound, at least 1; 1 if nobody has to move."""
        return self.makespan / self.lower_bound if self.lower_bound else 1.0

    @property
    def seconds(self) -> float:
        """Wall time of all phases."""
        return sum(phase.seconds for phase in self.phases)

    def check(self) -> ValidationReport:
        """Validate the paths anew."""
        return validate(self.paths, self.starts, self.goals, self.shape, self.obstacles)

    def save(self, path: str | Path) -> None:
        """Write the plan as .npz, whole or not at all.

        Raises:
            ValueError: another suffix.
            OSError: the file cannot be written.
        """
        from swarm_envs.baselines.rth3d.plan_file import write_plan

        write_plan(Path(path), self)

    @classmethod
    def load(cls, path: str | Path) -> GridPlan:
        """Read a plan; its paths are validated again.

        Raises:
            ValueError: the file is no plan, is damaged, or its paths are not feasible.
            OSError: it cannot be read.
        """
        from swarm_envs.baselines.rth3d.plan_file import read_plan

        return read_plan(Path(path))


def _check_limit(time_limit: float | None) -> float:
    if time_limit is None:
        return float("inf")
    number = isinstance(time_limit, Real) and not isinstance(time_limit, bool)
    if not number or not time_limit > 0:
        raise ValueError(f"time_limit is {time_limit!r}, but must be seconds above 0, or None")
    return time.monotonic() + float(time_limit)


@typed
def plan(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    obstacles: npt.ArrayLike | None = None,
    method: str = "auto",
    seed: int = 0,
    time_limit: float | None = None,
    watch: Callable[[str], None] | None = None,
) -> GridPlan:
    """Plan collision-free paths on a 6-connected grid for robots that each have their own goal.

    Args:
        starts: (n, 3) integers, all different: the vertices (x, y, z) that the robots start at.
        goals: (n, 3) integers, all different: where each must get.
        shape: (m1, m2, m3), or (m1, m2) with (n, 2) starts and goals.
        obstacles: booleans of that shape, True on whole columns at x = 3i + 1, y = 3j + 1, or for
            `"pibt"` anywhere; or None.
        method: `"rth3d"` (any matchings) and `"rth3d-lba"` (small shifts) always succeed up to
            `max_density(shape, obstacles)`; `"pibt"` takes any density and promises nothing;
            `"auto"` is the best of the last two.
        seed: of PIBT's choices; the others make none. The same seed gives the same plan, unless a
            time limit cuts it short.
        time_limit: seconds after which no further phase begins.
        watch: called with the name of each phase when it begins.

    Returns:
        A plan that `validate` has found feasible.

    Raises:
        ValueError: the instance is none, or not one for the method; the message says why.
        PlanTimeout: the time ended before there was a valid plan.
        PlanNotFound: `"pibt"` has found none.
    """
    instance = check_instance(starts, goals, shape, obstacles)
    solver = METHODS[check_name("method", method, METHODS)]
    if method != "pibt":
        check_pattern(instance.obstacles)
    check_integer("seed", seed, 0)
    clock = Clock(_check_limit(time_limit), watch)
    announce_compilation(follow_paths)
    solution = _stay(instance) if instance.lower_bound == 0 else solver(instance, seed, clock)
    return _result(instance, solution, method, seed, clock)


def _stay(instance: GridInstance) -> Solution:
    return Solution(numbers(instance.starts, instance.shape)[None], "stay", 0)


def _result(
    instance: GridInstance, solution: Solution, method: str, seed: int, clock: Clock
) -> GridPlan:
    """Coordinates instead of numbers, validated."""
    total = int(np.prod(instance.shape))
    where = points(np.arange(total, dtype=np.int32), instance.shape).astype(np.int16)
    with clock.finish("validation") as record:
        paths = where[solution.paths]
        facts = (instance.starts, instance.goals, instance.shape, instance.obstacles)
        report = validate(paths, *facts)
        record(report.makespan)
    if not report:
        raise AssertionError(f"{method!r} has made an invalid plan: {report.reason}")
    return GridPlan(
        paths=paths,
        starts=instance.starts,
        goals=instance.goals,
        shape=instance.shape,
        obstacles=instance.obstacles,
        method=method,
        winner=solution.method,
        seed=seed,
        lower_bound=instance.lower_bound,
        bound=solution.bound,
        before_compaction=solution.before_compaction,
        phases=tuple(clock.phases),
        valid=bool(report),
    )
