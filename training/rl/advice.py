"""Suggestions for the training of a policy whose success rate is low."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from tqdm import tqdm

import swarm_envs
from swarm_envs.agents import Agent, load, recommended
from swarm_envs.agents.evaluation import AgentFailed, evaluate_agent
from swarm_envs.agents.protocol import flies_batches
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.validation import learning_of, validation_seeds

__all__ = ["advice"]

ENOUGH = 0.95  # Success rate from which nothing is suggested
MORE = 0.02  # Smallest difference of success rates that counts
EPISODES = 64  # Number of episodes of the evaluation of a teacher
NEAR = 7  # Number of neighbors that is enough in every task


def advice(config: RlConfig, task: str, results: Sequence[Mapping[str, float]]) -> list[str]:
    """Return suggestions, the most promising first; none for a policy that succeeds.

    Args:
        config: the options of the run, with the task's defaults.
        task: the versioned name.
        results: the results of the run's evaluations in order, from `evaluate_policy`.
    """
    rates = [_mean(result, "_success") for result in results]
    if max(rates) >= ENOUGH:
        return []
    found = [*_longer(config, rates), *_teacher(config, task, max(rates)), *_seeing(config)]
    if config.imitates and config.encoder == "mlp":
        found.append("a larger network: --encoder deep-set --hidden 128 128 --set-hidden 64 64")
    collisions = _mean(results[-1], "_collision")
    if config.action == "acceleration" and collisions > 0.5 * (1.0 - rates[-1]):
        found.append(
            f"drones collide in {collisions:.0%} of the episodes (mean of layouts): add a safety "
            f"filter, --agent {config.out}+filter"
        )
    return found


def _mean(result: Mapping[str, float], measure: str) -> float:
    return float(np.mean([value for name, value in result.items() if name.endswith(measure)]))


def _longer(config: RlConfig, rates: Sequence[float]) -> list[str]:
    """Suggest more steps if the success rate still increased at the end, or steps were few."""
    if len(rates) > 1 and rates[-1] == max(rates) and rates[-1] - rates[-2] >= MORE:
        rise = f"the success rate still increased, from {rates[-2]:.1%} to {rates[-1]:.1%}"
        return [f"{rise}: train longer, --steps {2 * config.steps}"]
    if config.steps < RlConfig.steps:
        return [f"{config.steps:,} steps are few: train longer, --steps {RlConfig.steps}"]
    return []


def _teacher(config: RlConfig, task: str, reached: float) -> list[str]:
    """Suggest another teacher if this one does not succeed, or imitation of one that does."""
    best = _best_agent(config, task)
    if not config.imitates:
        hint = f"imitation learns faster: --algo dagger --dagger.teacher {best}"
        return [hint] if best else []
    name = config.dagger.teacher[-1].rpartition("=")[2]
    measured = _success(config, task, load(name))
    if measured is None or measured >= max(ENOUGH, reached + MORE):
        return [] if measured is None else _paced(config, name, measured)
    finding = f"the teacher {name} itself succeeds in {measured:.0%} of {EPISODES} episodes"
    another = f": try another, --dagger.teacher {best}" if best not in ("", name) else ""
    return [finding + another]


def _paced(config: RlConfig, name: str, measured: float) -> list[str]:
    """Suggest the decision rate of a teacher that succeeds."""
    rate = load(name).requires.get("decision_rate", config.decision_rate)
    if rate == config.decision_rate:
        return []
    finding = f"the teacher {name} succeeds in {measured:.0%} of {EPISODES} episodes"
    return [f"{finding}, with {rate} decisions per second: --decision-rate {rate}"]


def _seeing(config: RlConfig) -> list[str]:
    """Suggest more observed neighbors if some are not observed."""
    others = max(config.team_sizes) - 1
    if config.num_neighbors >= min(others, NEAR):
        return []
    return [
        f"the policy observes {config.num_neighbors} of {others} neighbors: observe more, "
        f"--neighbors {min(others, NEAR)}"
    ]


def _best_agent(config: RlConfig, task: str) -> str:
    """Return the best included script with the policy's action and no true state; "" for none."""
    layouts = learning_of(task).layouts[str(config.layout)]
    team: dict[str, Any] = {"num_drones": max(config.team_sizes)}
    if config.team:
        team = {"team": config.team[-1]}
    properties = {"learned": False, "privileged": False, "layout": layouts.get("layout"), **team}
    try:
        name = recommended(task, **properties, world=config.world)
    except ValueError:
        return ""
    return name if load(name).requires.get("action") == config.action else ""


def _success(config: RlConfig, task: str, agent: Agent) -> float | None:
    """Return a teacher's success rate on validation seeds; None if it is no `BatchAgent`."""
    learning = learning_of(task)
    given: dict[str, Any] = {**learning.layouts[str(config.layout)], **config.teams[-1]}
    given |= {"interactions": config.interactions, "physics": "batch", **config.world_options()}
    try:
        with closing(swarm_envs.make(task, **{**given, **agent.requires})) as env:
            if not flies_batches(env, agent):
                return None
            flights = evaluate_agent(env, agent, validation_seeds(EPISODES), timed=1)
            bar = {"total": EPISODES, "leave": False, "delay": 2.0, "disable": not config.progress}
            flown = list(tqdm(flights, "evaluating the teacher", unit="episode", **bar))
    except (AgentFailed, ValueError):
        return None
    return float(np.mean([episode["metrics"]["success"] for episode in flown]))
