"""Measure how much a policy gains from experience with interaction forces.

    python -m examples.force_knowledge --out runs/forces
    python -m examples.force_knowledge --task sprint --seeds 0 --steps 300000 --out runs/sprint

Policies learn by imitation (DAgger) under three conditions: without interaction forces (`none`),
with them (`learned`), and with them in the hall (`hall`); without and with the predicted force as
an observation. Each policy is evaluated under all three. The tracking controller is that of `pid`,
which has no force model and estimates no force; the teachers shift set-points by the displacement
that the true force would cause.

The table has means over training seeds and episodes. Intervals are 95 % bootstrap intervals in
which seeds, and episodes of each, are resampled. The same command trains missing policies only.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs import make
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.envs.core import SwarmCore
from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import claimed, write_json
from swarm_envs.state import FloatArray
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import finished_report, train_policy
from swarm_envs.training.rl.teachers import (
    DeliveryInTime,
    SetpointTeacher,
    SprintInTime,
    TimedTeacher,
)
from swarm_envs.training.scoreboard.summary import align_columns

CONDITIONS: Mapping[str, Mapping[str, Any]] = {
    "none": {"interactions": "none", "world": "ideal"},
    "learned": {"interactions": "learned", "world": "ideal"},
    "hall": {"interactions": "learned", "world": "hall"},
}
"""The conditions of training and evaluation: options of the environment."""
RECIPE: Mapping[str, Any] = {
    **{"algo": "dagger", "environments": 96, "threads": 1},
    **{"action": "velocity", "decision_rate": 48, "controller": "pid"},
    "encoder": "deep-set",
    **{"set_hidden": (48, 48), "hidden": (96, 96)},
    **{"checkpoint_rollouts": 100, "evaluations": 1, "evaluation_episodes": 64},
    **{"progress": False},
}
"""Options of every training run."""
EPISODE_SEED = 7  # Of the evaluation episodes


class Case(NamedTuple):
    """A task of the study."""

    task: str
    """The versioned name."""
    drones: int
    """The number of drones."""
    teacher: str
    """The class of the teacher in this file."""
    options: Mapping[str, Any] = {}
    """The options of the environment and of the training run."""
    measure: str = "success"
    """The metric of an episode that is averaged."""


_GATES = {"horizon_s": 12.0, "num_obstacles": 2}
CASES: Mapping[str, Case] = {
    "stack": Case("columns_v0", 8, "StackOracle", {"layout": "stack"}),
    "sprint": Case("columns_v0", 6, "SprintOracle", {"layout": "sprint"}),
    "delivery": Case("delivery_v0", 7, "DeliveryOracle"),
    "gates": Case("gates_v0", 4, "OracleTeacher", _GATES, "gates_per_min"),
}
"""The tasks of the benchmark's family *air*, by name."""


@dataclass(frozen=True, kw_only=True)
class ForceStudy:
    """Train policies under three conditions, and evaluate each under all of them."""

    out: Path
    """folder of the runs and results.json"""
    task: list[str] = field(default_factory=lambda: list(CASES))
    """`stack`, `sprint`, `delivery`, `gates`"""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    """training seeds"""
    steps: int = 1_000_000
    """decisions of single drones in each training run"""
    episodes: int = 128
    """evaluation episodes of each policy under each condition"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        for seed in self.seeds:
            check_integer("--seeds", seed, at_least=0)
        check_integer("--steps", self.steps, at_least=1)
        check_integer("--episodes", self.episodes, at_least=1)
        for name in self.task:
            check_name("--task", name, CASES)


class OracleTeacher(SetpointTeacher):
    """Teacher that reads the true force, with a controller without a force model."""

    controller = "pid"

    def shift(self, core: SwarmCore) -> FloatArray:
        """Return the shift of set-points that cancels the displacement by the true force, m."""
        drones, g = core.world.drones, self.requires["controller"].gains
        unknown = all_force(core) - drones["adaptive_force"]
        learned = g.velocity * g.integral * drones["velocity_integral"]
        pushed = unknown / drones["nominal_mass"][..., None] - learned
        return np.asarray(-pushed / (g.position * (g.velocity + g.integral)))


def all_force(core: SwarmCore) -> FloatArray:
    """Return the interaction force (E, N, 3) and the vertical random force of the hall, N.

    The physics does not store the random force; it is computed again from its process, for drones
    with neighbors.
    """
    force, drones = np.array(core.physics.force), core.world.drones
    if core.config.hall is not None:
        felt = np.linalg.norm(force, axis=-1)
        grown = felt / (felt + drones["residual_half"])
        size = drones["residual_quiet"] + drones["residual_more"] * grown
        force[..., 2] += size * drones["residual_process"][..., 2] + drones["force_offset"]
    return force


class StackOracle(OracleTeacher, TimedTeacher):
    """`OracleTeacher` with a fixed duration, for `stack`; without forces, for the nearest goals."""

    def assigned_places(self, core: SwarmCore) -> FloatArray:
        """Return the goals that are assigned to drones, or without forces those of the task."""
        if core.config.interactions == "none":
            return np.array(core.world.drones["goal"])
        return super().assigned_places(core)


class SprintOracle(OracleTeacher, SprintInTime):
    """`OracleTeacher` with the duration of the layout `sprint`."""


class DeliveryOracle(OracleTeacher, DeliveryInTime):
    """`OracleTeacher` with the duration of the task `delivery`."""


def training_of(study: ForceStudy, task: str, condition: str, force: bool, seed: int) -> RlConfig:
    """Return the options of a training run."""
    case = CASES[task]
    given = {
        **RECIPE,
        **case.options,
        **CONDITIONS[condition],
        "task": case.task,
        "drones": case.drones,
    }
    return RlConfig(
        **given,
        out=study.out / task / (f"{condition}-force" if force else condition) / f"seed-{seed}",
        dagger=replace(RlConfig.dagger, teacher=(f"{__file__}:{case.teacher}",)),
        num_neighbors=case.drones - 1,
        observe_force=force,
        steps=study.steps,
        seed=seed,
    )


def fly_in(study: ForceStudy, config: RlConfig, task: str, condition: str) -> list[float]:
    """Return the metric of a trained policy in each episode under a condition."""
    agent, case = load(config.out), CASES[task]
    setting = {
        **case.options,
        **CONDITIONS[condition],
        "num_drones": case.drones,
        "physics": "batch",
    }
    env = make(case.task, **{**setting, **agent.requires, "threads": 1})
    try:
        episodes = evaluate_agent(env, agent, frozen_seeds(EPISODE_SEED, study.episodes), timed=0)
        return [float(episode["metrics"][case.measure]) for episode in episodes]
    finally:
        env.close()


def summary_of(values: FloatArray) -> dict[str, Any]:
    """Return the mean of values (seeds, episodes), its interval, and the mean of each seed."""
    rng, (seeds, episodes) = np.random.default_rng(0), values.shape
    rows = rng.integers(seeds, size=(2000, seeds, 1))
    means = values[rows, rng.integers(episodes, size=(2000, seeds, episodes))].mean(axis=(1, 2))
    ends = np.percentile(means, (2.5, 97.5)).tolist()
    return {"mean": float(values.mean()), "interval": ends, "each": values.mean(axis=1).tolist()}


def run_study(study: ForceStudy) -> list[dict[str, Any]]:
    """Train the missing policies, evaluate all, write the results, and return them."""
    students, results = list(product(study.task, CONDITIONS, (False, True))), []
    with (
        claimed(study.out),
        tqdm(total=len(students) * len(study.seeds), unit="policy", desc="study") as bar,
    ):
        for task, condition, force in students:
            flown: dict[str, list[list[float]]] = {name: [] for name in CONDITIONS}
            for seed in study.seeds:
                config = training_of(study, task, condition, force, seed)
                bar.set_postfix_str(f"{task}, {condition}")
                if finished_report(config, config.task) is None:
                    train_policy(config, config.task)
                for name, episodes in flown.items():
                    episodes.append(fly_in(study, config, task, name))
                bar.update()
            entry = {name: summary_of(np.array(values)) for name, values in flown.items()}
            results.append(
                {"task": task, "condition": condition, "force": force, "flown_in": entry}
            )
        write_json(study.out / "results.json", results)
    return results


def table_of(results: list[dict[str, Any]]) -> str:
    """Return a table with a line for each kind of policy and its result under each condition."""
    rows = [["task", "trained in", "observes force", *(f"in {name}" for name in CONDITIONS)]]
    for entry in results:
        scale = 100.0 if CASES[entry["task"]].measure == "success" else 1.0
        cells = []
        for found in entry["flown_in"].values():
            mean, low, high = (scale * x for x in (found["mean"], *found["interval"]))
            cells.append(f"{mean:.1f} ({low:.1f}-{high:.1f})")
        rows.append([entry["task"], entry["condition"], "yes" if entry["force"] else "no", *cells])
    return "\n".join(align_columns(rows))


if __name__ == "__main__":
    sys.stdout.write(table_of(run_study(tyro.cli(ForceStudy))) + "\n")
