"""Fly the certificates of the benchmark's tasks: that each of version 2 can be solved.

    python -m swarm_envs.training.scoreboard.certificates 'swap-*-v2' --episodes 64

prints the share of episodes in which each task's certificate succeeds, and exits with 1 if one has
less than 95 %. Episodes are the first of the benchmark's own.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.arguments import Count
from swarm_envs.training.scoreboard.tasks import SEED, ScoredTask, choose_tasks, make_scored

ENOUGH = 0.95
"""Share of episodes in which a certificate succeeds."""


@dataclass(frozen=True, kw_only=True)
class CertifyOptions:
    """Fly the certificates of tasks."""

    tasks: Annotated[Sequence[str], tyro.conf.Positional] = ("*-v2",)
    """ids, or patterns of them in quotes"""
    episodes: Count = 64
    """of each task"""


def certify(task: ScoredTask, episodes: int) -> float:
    """Share of a task's first episodes in which its certificate succeeds.

    Raises:
        ValueError: the task has none.
    """
    if not task.certificate:
        raise ValueError(f"{task.id} has no certificate: those of version 2 have")
    name, _, clock_s = task.certificate.partition("@")
    agent, longer = load(name), {"horizon_s": float(clock_s)} if clock_s else {}
    env = make_scored(task.environment, {**task.setting, **longer, **agent.requires})
    flown = list(evaluate_agent(env, agent, frozen_seeds(SEED, episodes), timed=1))
    env.close()
    return sum(bool(each["metrics"]["success"]) for each in flown) / len(flown)


def certify_all(options: CertifyOptions) -> bool:
    """Print a line a task, and say whether all are solved."""
    good = True
    for task in choose_tasks(list(options.tasks)):
        share = certify(task, options.episodes)
        good = good and share >= ENOUGH
        sys.stdout.write(f"{task.id:28} {task.certificate:24} {100.0 * share:5.1f} %\n")
        sys.stdout.flush()
    return good


if __name__ == "__main__":
    sys.exit(0 if certify_all(tyro.cli(CertifyOptions)) else 1)
