"""The defaults of a task's training, and how policies are chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.agents.protocol import AT_ONCE, fly_batch
from swarm_envs.agents.registry import controller_of
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of, task_class
from swarm_envs.errors import check_name
from swarm_envs.tasks.learning import ALL, Learning
from swarm_envs.training.rl.rl_config import RlConfig

__all__ = ["choosing_seeds", "evaluate_policy", "learning_of", "with_defaults"]


def learning_of(task: str) -> Learning:
    """Return how a task is learned: by its class, or as it is.

    Args:
        task: its versioned name, or `path/to/file.py:Class`.

    Raises:
        ValueError: there is no such task.
    """
    learning = task_class(task).learning
    return Learning(layouts={"own": {}}, horizon_s=None) if learning is None else learning


def with_defaults(config: RlConfig, task: str) -> RlConfig:
    """Return the options of a run, with the defaults of its task for what was not given.

    Raises:
        ValueError: the task has no such layout, the algorithm learns one layout alone, or no agent
            has such a controller.
    """
    learning = learning_of(task)
    defaults: dict[str, Any] = {
        "layout": next(iter(learning.layouts)),
        "horizon_s": learning.horizon_s,
        "observe_load": learning.observe_load,
        "num_obstacles": 3 if learning.has_obstacles or config.obstacles else 0,
    }
    missing = [name for name in defaults if getattr(config, name) is None]
    whole = replace(config, **{name: defaults[name] for name in missing})
    check_name("--layout", whole.layout, learning.layouts)
    if config.controller is not None:
        controller_of(config.controller)
    if whole.layout == ALL and not config.imitates:
        single = ", ".join(sorted({*learning.layouts} - {ALL}))
        raise ValueError(
            f"all layouts of {task} together are learned by --algo dagger alone; name one by "
            f"--layout: {single}"
        )
    return whole


CHOOSING = (0x63686F6F, 0x73696E67)
"""Entropy of the seeds on which policies are chosen: no `--seed` of `evaluate` draws the same."""


def choosing_seeds(count: int) -> list[int]:
    """Return seeds of so many episodes, never trained on; fewer are the first of more."""
    return [int(word) for word in np.random.SeedSequence(CHOOSING).generate_state(count)]


def evaluate_policy(
    policy: Policy,
    task: str,
    layouts: Sequence[str],
    seeds: Sequence[int],
    options: Mapping[str, Any],
    teams: Sequence[Mapping[str, Any]] = (),
) -> dict[str, float]:
    """Return averages of the task's measures on each layout, such as `random_success`.

    Args:
        policy: what is evaluated.
        task: versioned name.
        layouts: of the task.
        seeds: of the episodes, the same on each layout.
        options: of the environments, besides what the policy requires.
        teams: options of each team that flies; of several each has its own averages, such as
            `random_8_success` of eight drones. With none the other options give the team.
    """
    agent, learning, found = PolicyAgent(policy), learning_of(task), {}
    for team, layout in product(teams or ({},), layouts):
        given = {"threads": 1, **options, **team, **learning.layouts[layout], **agent.requires}
        blueprint = batch_of(task, **given)
        core = SwarmCore(blueprint.task, blueprint.config, min(AT_ONCE, len(seeds)))
        metrics = fly_batch(core, agent.act_batch, seeds)
        core.close()
        short = "_".join(map(str, team.values()))
        flown = layout if len(teams) < 2 else f"{layout}_{short}"
        for name, measure in learning.measures.items():
            found[f"{flown}_{name}"] = float(np.mean([measure(m) for m in metrics]))
    return found
