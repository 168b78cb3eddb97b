"""Tune the parameters of scripted agents by random search, on other seeds than the benchmark.

    python -m examples.tune_agents --agent roundabout --trials 60 --out tune.jsonl
    python -m examples.tune_agents --agent downwash-aware --task air-sprint-8-v3 --out sprint.jsonl

Each trial changes some numbers of the best candidate and evaluates it, every candidate on the same
seeds. The cases of `fast-line`, `orca` and `roundabout` are random and circular swaps of 4 to 32
drones, those of the others the *air* tasks of the benchmark. A trial is a line of the file. The
script prints the best numbers; those of the included agents are in `TUNED` of
`swarm_envs.agents.avoiding` and `swarm_envs.baselines.neural_swarm.downwash`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs.agents import avoiding
from swarm_envs.agents.evaluation import AgentRefused, evaluate_agent, frozen_seeds
from swarm_envs.baselines.neural_swarm import downwash
from swarm_envs.errors import check_integer
from swarm_envs.training.scoreboard.tasks import choose_tasks, make_scored

Candidate = avoiding.Avoidance | downwash.DownwashSettings
TUNED: Mapping[str, Candidate] = {**avoiding.TUNED, **downwash.TUNED}
"""The initial candidates, by the name of the agent."""


class Case(NamedTuple):
    """An environment in which candidates are evaluated."""

    environment: str
    """The first argument of `swarm_envs.make`."""
    setting: Mapping[str, Any]
    """The options of the environment."""


_CLOCK_S = 12.0
_SWAPS = (("random", 4), ("random", 8), ("random", 16), ("random", 32), ("circle", 4),
          ("circle", 8), ("circle", 12), ("circle", 16))  # fmt: skip
_SPREAD = 0.2
"""The standard deviation of the logarithm of the factor of a number."""
_OF_TIME, _OF_NEAR_MISSES = 0.02, 0.2
"""The costs of a second and of a share of near misses, as shares of success."""


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """Tune the numbers of an agent by random search around the best candidate."""

    agent: str
    """one of `fast-line`, `orca`, `roundabout`, `pid`, `pid+adaptive`, `downwash-aware`,
    `heavy-on-top`"""
    out: Path
    """file of the trials, one line of JSON for each"""
    task: list[str] = field(default_factory=list)
    """tasks of the benchmark, ids or quoted patterns, in place of the usual cases"""
    trials: int = 60
    """number of candidates; the first is that of the package"""
    episodes: int = 64
    """number of episodes of each case"""
    seed: int = 515
    """random seed of the episodes and the candidates, other than that of the benchmark"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        check_integer("--trials", self.trials, at_least=1)
        check_integer("--episodes", self.episodes, at_least=1)
        check_integer("--seed", self.seed, at_least=0)


def cases_of(agent: str, tasks: Sequence[str] = ()) -> list[Case]:
    """Return the cases of an agent: tasks of the benchmark, or swaps of 4 to 32 drones."""
    if agent in downwash.TUNED or tasks:
        usual = ["air-stack-*"] if agent == "heavy-on-top" else ["air-sprint-*", "air-delivery-*"]
        chosen = choose_tasks(tasks or usual)
        return [Case(task.environment, task.setting) for task in chosen]
    common = {"physics": "batch", "horizon_s": _CLOCK_S}
    return [Case("swap_v1", {"layout": layout, "num_drones": n, **common}) for layout, n in _SWAPS]


def value_of(candidate: Candidate, seeds: Sequence[int], cases: Sequence[Case]) -> float:
    """Return the mean over cases of success minus the costs of near misses and time."""
    return float(np.mean([_value(candidate, seeds, case) for case in cases]))


def _value(candidate: Candidate, seeds: Sequence[int], case: Case) -> float:
    agent = candidate.agent()
    env = make_scored(case.environment, {**case.setting, **agent.requires})
    try:
        metrics = [each["metrics"] for each in evaluate_agent(env, agent, seeds, timed=0)]
    except AgentRefused:
        return -_OF_TIME * env.view.horizon_s
    finally:
        env.close()
    won = [m["time_to_goal_s"] or m["length_s"] for m in metrics if m["success"]]
    near = sum(m["near_misses"] > 0 for m in metrics)
    took = float(np.mean(won)) if won else env.view.horizon_s
    return (len(won) - _OF_NEAR_MISSES * near) / len(metrics) - _OF_TIME * took


def numbers_of(candidate: Any) -> dict[str, Any]:
    """Return the floats of a candidate by name, nested by part."""
    values = {f.name: getattr(candidate, f.name) for f in dataclasses.fields(candidate)}
    return {
        name: numbers_of(value) if dataclasses.is_dataclass(value) else value
        for name, value in values.items()
        if dataclasses.is_dataclass(value) or isinstance(value, float)
    }


def with_numbers(candidate: Any, numbers: Mapping[str, Any]) -> Any:
    """Return a candidate with other numbers.

    Raises:
        ValueError: a number is out of its range.
    """
    changed = {
        name: with_numbers(getattr(candidate, name), value) if isinstance(value, Mapping) else value
        for name, value in numbers.items()
    }
    return dataclasses.replace(candidate, **changed)


def neighbor_of(candidate: Candidate, rng: np.random.Generator) -> Candidate:
    """Return a candidate with some numbers changed at random."""

    def changed(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: changed(part) for name, part in value.items()}
        return (
            float(f"{value * np.exp(_SPREAD * rng.normal()):.3g}") if rng.random() < 0.4 else value
        )

    while True:
        try:
            other: Candidate = with_numbers(candidate, changed(numbers_of(candidate)))
            return other
        except ValueError:
            continue  # Out of range: sample again


def tune_agent(options: TuneOptions) -> tuple[Candidate, float]:
    """Evaluate and write candidates, and return the best one with its value.

    Raises:
        KeyError: the agent has no numbers to tune.
        FileExistsError: the file exists.
    """
    best, highest = TUNED[options.agent], -np.inf
    seeds = frozen_seeds(options.seed, options.episodes)
    cases = cases_of(options.agent, options.task)
    with options.out.open("x", encoding="utf-8") as file:
        for k in tqdm(range(options.trials), desc=options.agent, unit="trial"):
            candidate = neighbor_of(best, np.random.default_rng([options.seed, k])) if k else best
            value = value_of(candidate, seeds, cases)
            trial = {"trial": k, "numbers": numbers_of(candidate), "value": value}
            file.write(json.dumps(trial) + "\n")
            file.flush()
            if value > highest:
                best, highest = candidate, value
    return best, highest


if __name__ == "__main__":
    chosen = tyro.cli(TuneOptions)
    if chosen.out.exists():
        sys.exit(f"{chosen.out} exists; delete it, or name another file by --out")
    found, worth = tune_agent(chosen)
    sys.stdout.write(f"{worth:.4f} {json.dumps(numbers_of(found))}\n")
