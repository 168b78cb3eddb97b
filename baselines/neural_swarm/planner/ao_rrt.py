"""Stage 1: sequential kinodynamic AO-RRT for a team with interaction forces (Sec. V-A).

Robots are planned one after another in a random order, each by its own tree among the motions of
the others. Robots without a motion are ignored, and avoid the others when they are planned. Costs
are those of eq. (6), the integral of ||u||, summed over *all* robots: the cost of a robot whose
downwash pushes a neighbor includes the thrust with which the neighbor stays on its path. The cost
of the team bounds every later tree, so it only falls.

Eq. (6) leaves the duration free, but longer flights are cheaper, as a robot may always wait. So
plans last as long as the problem allows.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.propagation import INVALID, make_scene, working_state
from swarm_envs.baselines.neural_swarm.planner.search_tree import Chances, empty_tree, grow_tree
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    trajectories_through,
)
from swarm_envs.compiled import entry_point
from swarm_envs.errors import check_integer, check_number, check_type
from swarm_envs.state import FloatArray

Stop = Literal["iterations", "no improvement", "time limit"]  # The reason for a search's end

_NODES_PER_ITERATION = 8  # The average is lower; a full tree ends early


@dataclass(frozen=True)
class SearchConfig:
    """The options of stage 1."""

    iterations: int = 100_000
    """The most iterations (lines 6 to 11) of all trees together."""
    iterations_per_tree: int = 2000
    """The most iterations of one tree."""
    patience: int = 1000
    """The most outer loops in a row without a cheaper plan."""
    time_limit: float | None = None
    """The longest wall-clock time, s, checked after each tree; None for no limit. Results with a
    limit are not reproducible."""
    edge: int = 2
    """The number of steps over which an action is held: the paper's constant delta t."""
    fresh: float = 0.5
    """The probability that an outer loop plans all robots anew, below the cost bound, instead of
    replanning each among the present motions. It allows to leave a poor homeomorphism class."""
    least_gain: float = 0.005
    """The share by which a new plan must be cheaper than the best."""
    chances: Chances = field(default_factory=Chances)
    """The probabilities of the choices in an iteration."""

    @classmethod
    def published(cls, **others: Any) -> SearchConfig:
        """Return the options of AO-RRT as in the paper (Algorithm 1, Sec. V-A).

        Samples are uniform, or the goal in a tenth of the iterations (version 2 of the paper, in
        fixed intervals there). The nearest node holds a random action for one edge; no node is
        steered to the goal. Each outer loop plans all robots anew, below the bound, which is the
        team's cost where the paper has each robot's.

        Args:
            **others: Options that differ, such as `iterations`.
        """
        chances = Chances(goal=0.0, action=1.0, promising=0.0, guided=0.0, biased=0.1)
        paper = {"chances": chances, "fresh": 1.0, "least_gain": 0.0, "iterations_per_tree": 20_000}
        return cls(**{**paper, **others})

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("iterations", "iterations_per_tree", "patience", "edge"):
            check_integer(name, getattr(self, name), at_least=1)
        if self.time_limit is not None:
            check_number("time_limit", self.time_limit, above=0.0, unit="s")
        check_number("fresh", self.fresh, at_least=0.0, at_most=1.0)
        check_number("least_gain", self.least_gain, at_least=0.0, below=1.0)
        check_type("chances", self.chances, Chances)
        for name, chance in self.chances._asdict().items():
            check_number(f"chances.{name}", chance, at_least=0.0, at_most=1.0)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of stage 1."""

    trajectories: Trajectories | None  # The cheapest plan; None if none was found
    costs: tuple[float, ...]
    """The cost of the best plan after each outer loop, the integral of ||u|| of all robots (eq. 6),
    m/s; infinite as long as there is none."""
    iterations: int  # Iterations in all trees
    stop: Stop  # The reason for its end

    @property
    def cost(self) -> float:
        """The cost of the plan, m/s."""
        return self.costs[-1]

    @property
    def converged(self) -> bool:
        """True if there is a plan and no time limit ended the search."""
        return self.trajectories is not None and self.stop != "time limit"


def search(
    problem: PlanningProblem,
    config: SearchConfig | None = None,
    seed: int | np.random.Generator = 0,
) -> SearchResult:
    """Search valid trajectories of a team, and reduce their cost.

    The trajectories follow their controls and forces up to rounding, keep all bounds of the
    problem, and end within epsilon of the goals.

    Args:
        problem: The planning problem.
        config: The options, or None for the defaults.
        seed: The random seed, or a generator.

    Raises:
        ValueError: An edge is longer than the longest plan.
    """
    options = config or SearchConfig()
    if options.edge > problem.steps:
        raise ValueError(
            f"edge is {options.edge} steps, but max_duration allows {problem.steps}; shorten it"
        )
    return _Search(problem, options, np.random.default_rng(seed)).run()


class _Search:
    """The state of a search, with the best plan so far."""

    def __init__(
        self, problem: PlanningProblem, options: SearchConfig, rng: np.random.Generator
    ) -> None:
        self.problem, self.options, self.rng = problem, options, rng
        self.robots = len(problem.team)
        self.knots = problem.steps // options.edge * options.edge + 1
        room = _NODES_PER_ITERATION * options.iterations_per_tree + 2 * self.knots
        self.tree = empty_tree(room, self.robots)
        self.best: FloatArray | None = None
        self.cost = np.inf
        self.iterations = 0
        self.deadline = time.monotonic() + (options.time_limit or np.inf)

    def run(self) -> SearchResult:
        """Run outer loops until a reason to stop."""
        costs: list[float] = []
        stop, idle = None, 0
        while stop is None:
            before = self.cost  # One outer loop (lines 3 to 15): every robot once, in random order
            if self.best is None or self.rng.random() < self.options.fresh:
                self.plan_afresh()
            else:
                self.replan_each()
            costs.append(float(self.cost))
            idle = 0 if self.cost < before else idle + 1
            stop = self.stop(idle)
        found = None if self.best is None else trajectories_through(self.problem, self.best)
        return SearchResult(found, tuple(costs), self.iterations, stop)

    def stop(self, idle: int = 0) -> Stop | None:
        """Return the reason to stop now, if any, after `idle` loops without improvement."""
        if time.monotonic() >= self.deadline:
            return "time limit"
        if self.iterations >= self.options.iterations:
            return "iterations"
        return "no improvement" if idle >= self.options.patience else None

    def plan_afresh(self) -> None:
        """Plan all robots anew; give up if no path is found for one."""
        states = np.zeros((self.knots, self.robots, 6))
        planned: list[int] = []
        for robot in self.rng.permutation(self.robots).tolist():
            cost, path = self.plan_robot(robot, states, planned)
            if cost == INVALID:
                return
            states[:, robot] = path
            planned.append(robot)
        self.best, self.cost = states, cost

    def replan_each(self) -> None:
        """Replan one robot after another, with the others on their paths."""
        assert self.best is not None
        for robot in self.rng.permutation(self.robots).tolist():
            cost, path = self.plan_robot(robot, self.best, list(range(self.robots)))
            if cost != INVALID:
                self.best, self.cost = self.best.copy(), cost
                self.best[:, robot] = path

    def plan_robot(
        self, robot: int, states: FloatArray, planned: list[int]
    ) -> tuple[float, FloatArray]:
        """Grow one tree; return the team's cost with the new path, and the path (K + 1, 6)."""
        options, path = self.options, np.zeros((self.knots, 6))
        if self.stop() is not None:
            return INVALID, path
        scene = make_scene(self.problem, robot, states, planned, options.edge)
        given = (
            scene,
            self.tree,
            working_state(scene),
            self.cost * (1.0 - options.least_gain),
            min(options.iterations_per_tree, options.iterations - self.iterations),
            options.chances,
            self.rng,
            path,
        )
        cost, used, _ = entry_point(grow_tree, *given)(*given)
        self.iterations += max(used, 1)  # A robot that cannot begin would never end the search
        return cost, path
