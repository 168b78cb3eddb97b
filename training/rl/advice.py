"""Suggestions for a policy that does not succeed yet, from what its run measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

import swarm_envs
from swarm_envs.agents import Agent, load, recommended
from swarm_envs.agents.evaluation import AgentFailed, evaluate_agent
from swarm_envs.agents.protocol import flies_batches
from swarm_envs.training.rl.choosing import choosing_seeds, learning_of
from swarm_envs.training.rl.rl_config import RlConfig

__all__ = ["advice"]

ENOUGH = 0.95  # Success from which on nothing is suggested
MORE = 0.02  # Differences of success that count
EPISODES = 64  # In which a teacher is measured
NEAR = 7  # Neighbors that are enough in every task


def advice(config: RlConfig, task: str, results: Sequence[Mapping[str, float]]) -> list[str]:
    """Return what to try next, the most promising first; nothing for a policy that succeeds.

    Args:
        config: options of the run, with the task's defaults.
        task: versioned name.
        results: of the run's evaluations in order, as `evaluate_policy` returns them.
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
            f"drones collide in {collisions:.0%} of the episodes: fly it behind a safety filter, "
            f"--agent {config.out}+filter"
        )
    return found


def _mean(result: Mapping[str, float], measure: str) -> float:
    return float(np.mean([value for name, value in result.items() if name.endswith(measure)]))


def _longer(config: RlConfig, rates: Sequence[float]) -> list[str]:
    """Suggest more steps where success still rose in the end, or steps were few."""
    if len(rates) > 1 and rates[-1] == max(rates) and rates[-1] - rates[-2] >= MORE:
        said = f"success still rose, from {rates[-2]:.1%} to {rates[-1]:.1%}"
        return [f"{said}: train longer, --steps {2 * config.steps}"]
    if config.steps < RlConfig.steps:
        return [f"{config.steps:,} steps are few: train longer, --steps {RlConfig.steps}"]
    return []


def _teacher(config: RlConfig, task: str, reached: float) -> list[str]:
    """Suggest another teacher where this one does not succeed, or imitation of one that does."""
    best = _best_agent(config, task)
    if not config.imitates:
        said = f"imitation learns faster: --algo dagger --dagger.teacher {best}"
        return [said] if best else []
    name = config.dagger.teacher[-1].rpartition("=")[2]
    measured = _success(config, task, load(name))
    if measured is None or measured >= max(ENOUGH, reached + MORE):
        return [] if measured is None else _paced(config, name, measured)
    said = f"its teacher {name} itself succeeds in {measured:.0%} of {EPISODES} episodes"
    another = f": another is {best}, --dagger.teacher {best}" if best not in ("", name) else ""
    return [said + another]


def _paced(config: RlConfig, name: str, measured: float) -> list[str]:
    """Suggest to decide as often as a teacher that succeeds."""
    rate = load(name).requires.get("decision_rate", config.decision_rate)
    if rate == config.decision_rate:
        return []
    said = f"its teacher {name} succeeds in {measured:.0%} of {EPISODES} episodes"
    return [f"{said}, and decides {rate} times a second: --decision-rate {rate}"]


def _seeing(config: RlConfig) -> list[str]:
    """Suggest more neighbors where some are not observed."""
    others = max(config.team_sizes) - 1
    if config.num_neighbors >= min(others, NEAR):
        return []
    return [
        f"it observes {config.num_neighbors} of {others} neighbors: --neighbors {min(others, NEAR)}"
    ]


def _best_agent(config: RlConfig, task: str) -> str:
    """The best shipped script that acts as the policy does and sees no more; empty for none."""
    layouts = learning_of(task).layouts[str(config.layout)]
    team: dict[str, Any] = {"num_drones": max(config.team_sizes)}
    if config.team:
        team = {"team": config.team[-1]}
    asked = {"learned": False, "privileged": False, "layout": layouts.get("layout"), **team}
    try:
        name = recommended(task, **asked, world=config.world)
    except ValueError:
        return ""
    return name if load(name).requires.get("action") == config.action else ""


def _success(config: RlConfig, task: str, agent: Agent) -> float | None:
    """Success of a teacher on episodes for choosing; None if it does not fly many at once."""
    learning = learning_of(task)
    given: dict[str, Any] = {**learning.layouts[str(config.layout)], **config.teams[-1]}
    given |= {"interactions": config.interactions, "physics": "batch", **config.world_options()}
    try:
        with closing(swarm_envs.make(task, **{**given, **agent.requires})) as env:
            if not flies_batches(env, agent):
                return None
            flown = list(evaluate_agent(env, agent, choosing_seeds(EPISODES), timed=1))
    except (AgentFailed, ValueError):
        return None
    return float(np.mean([episode["metrics"]["success"] for episode in flown]))
