"""Small jobs that go through the kernels, and the arrays they end with.

`python -m tests.helpers.scenarios FOLDER NAME ...` writes the arrays of some to files. Each takes
seconds without compilation, so that a process with `NUMBA_DISABLE_JIT=1` can do what a compiled one
does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import swarm_envs
from swarm_envs.agents import load as load_agent
from swarm_envs.agents.features import features_of
from swarm_envs.baselines import mlr_dmpc, rth3d
from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig, search
from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.motion import Potential, push_apart
from swarm_envs.vehicles import parse_team
from tests.helpers.frozen import FLIGHTS, can_fly

Arrays = dict[str, FloatArray]


FLOWN = {
    "everything drawn": {"envs": 1, "decisions": 3},
    "obstacles in the way": {"envs": 1, "decisions": 3},
    "stacks by acceleration": {"envs": 1, "decisions": 2},
    "rings by rotors, into the floor": {"envs": 1, "decisions": 3},
    "formations by set-points": {"envs": 1, "decisions": 3},
    "rings by body rates": {"envs": 1, "decisions": 4},
    "circles by velocity": {"envs": 1, "decisions": 3},
    "26 drones": {"decisions": 1},
    "Bullet goes on": {"decisions": 2},
}
"""Frozen flights of all kinds, cut short."""


def fly(name: str) -> Arrays:
    """The first decisions of a frozen flight."""
    flown = replace(FLIGHTS[name], **FLOWN[name]).fly(1)
    return {**flown.arrays, "numbers": np.array(flown.numbers)}


def crowd() -> Arrays:
    """Forces on more drones than are compared each with each."""
    rng = np.random.default_rng(0)
    position = rng.uniform([-1.0, -1.0, 0.3], [1.0, 1.0, 2.0], (1, 26, 3))
    velocity, team = rng.normal(0.0, 0.3, position.shape), parse_team("SL" * 13)
    return {name: load(name).forces(position, velocity, team) for name in ("wake", "learned")}


def filtered() -> Arrays:
    """An agent behind the safety filter, and what a policy would see of it."""
    agent = load_agent("straight-line+filter")
    options = {**agent.requires, "physics": "batch", "interactions": "none"}
    env = swarm_envs.make("swap_v1", num_drones=3, layout="circle", **options)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    acts = []
    for _ in range(12):
        actions = agent.act(observations, env.view if agent.privileged else None)
        acts.append([actions[name] for name in actions])
        observations, *_ = env.step(actions)
    rows = np.stack([observations[name] for name in observations])
    neighbors = env.core.config.num_neighbors
    env.close()
    return {
        "actions": np.array(acts),
        "features": features_of(rows, neighbors).astype(np.float64),
    }


def grid_plans() -> Arrays:
    """Every method on a full grid, and one with walls."""
    found: Arrays = {}
    dense = rth3d.make_instance("uniform", (6, 6, 3), seed=0)
    walled = rth3d.make_instance("buildings", (9, 9, 4), 20, seed=0)
    for name, instance in (("dense", dense), ("walled", walled)):
        for method in ("rth3d", "rth3d-lba", "pibt"):
            paths = rth3d.plan(**instance.fields(), method=method).paths
            found[f"{name}-{method}"] = paths.astype(np.float64)
    return found


def tree_search() -> Arrays:
    """Stage 1 for two robots that change places."""
    starts = np.array([[0.0, -0.5, 1.0], [0.0, 0.5, 1.0]])
    model = load("none")
    problem = PlanningProblem(starts, starts[::-1].copy(), parse_team("SS"), model, plane="yz")
    found = search(problem, SearchConfig(iterations=400, iterations_per_tree=200), seed=0)
    plan = found.trajectories
    return {"cost": np.array([found.cost])} | ({"states": plan.states} if plan else {})


def rounds() -> Arrays:
    """MLR-DMPC for three drones, with losses."""
    starts = np.array([[-0.6, 0.0, 1.0], [0.6, 0.0, 1.0], [0.0, 0.8, 1.0]])
    done = mlr_dmpc.simulate(
        starts, starts[[1, 0, 2]], compute_units=2, loss=0.1, seed=0, duration_s=1.6
    )
    return {"positions": done.reference_positions}


def repulsion() -> Arrays:
    """The potentials that keep collecting drones apart."""
    rng, out = np.random.default_rng(0), np.zeros((2, 5, 3))
    position = rng.uniform([-0.4, -0.4, 0.1], [0.4, 0.4, 0.9], out.shape)
    near, floor = Potential(0.3, 0.02, 4.0), Potential(0.4, 0.02, 3.0)
    push_apart(position, np.full(5, 0.06), near, floor, out)
    return {"push": out}


SCENARIOS: dict[str, Callable[[], Arrays]] = {
    **{name: partial(fly, name) for name in FLOWN if can_fly(name)},
    **{f.__name__: f for f in (crowd, filtered, grid_plans, tree_search, rounds, repulsion)},
}
"""Every job by its name."""
LONG = ("grid_plans", "tree_search", "filtered", "crowd", "everything drawn")
"""Jobs that take more than 10 s, with the compilation of what they call."""


if __name__ == "__main__":
    for name in sys.argv[2:]:
        np.savez(Path(sys.argv[1], f"{name}.npz"), **SCENARIOS[name]())  # type: ignore[arg-type]
