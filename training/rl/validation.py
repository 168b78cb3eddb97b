"""The defaults of a task's training, and the validation of policies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import product
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.agents.protocol import AT_ONCE, fly_batch
from swarm_envs.agents.registry import controller_of
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of, task_class
from swarm_envs.errors import check_name
from swarm_envs.tasks.learning import ALL, Learning
from swarm_envs.training.rl.rl_config import RlConfig

__all__ = ["evaluate_policy", "learning_of", "validation_seeds", "with_defaults"]


def learning_of(task: str) -> Learning:
    """Return the settings of a task's training; a task without any is used as it is.

    Args:
        task: the versioned name, or `path/to/file.py:Class`.

    Raises:
        ValueError: there is no such task.
    """
    kind = task_class(task)
    if kind.learning is not None:
        return kind.learning
    default = {field.name: field.default for field in fields(kind)}.get("layout")
    names = sorted(kind.layouts, key=default.__ne__)  # the default first
    layouts = {name: {"layout": name} for name in names} or {"task": {}}
    return Learning(layouts=layouts, horizon_s=None)


def with_defaults(config: RlConfig, task: str) -> RlConfig:
    """Return the options of a run, with the defaults of its task for options that are None.

    Raises:
        ValueError: the task has no such layout, the algorithm does not support all layouts
            together, or no agent has such a controller.
    """
    learning = learning_of(task)
    defaults: dict[str, Any] = {
        "layout": next(iter(learning.layouts)),
        "horizon_s": learning.horizon_s,
        "observe_load": learning.observe_load,
        "num_obstacles": 3 if learning.has_obstacles or config.obstacles else 0,
    }
    given = {name: value for name, value in defaults.items() if getattr(config, name) is None}
    layout = given.get("layout", config.layout)
    check_name("--layout", layout, learning.layouts)
    if not config.teams:
        made = batch_of(task, **{**learning.layouts[str(layout)], **config.world_options()})
        tokens = [vehicle.token for vehicle in made.task.team]
        small = {*tokens} == {"S"}  # then it is the same run as with --drones
        given |= {"drones": len(tokens)} if small else {"team": ("".join(tokens),)}
    whole = replace(config, **given)
    if config.controller is not None:
        controller_of(config.controller)
    if whole.layout == ALL and not config.imitates:
        single = ", ".join(sorted({*learning.layouts} - {ALL}))
        raise ValueError(
            f"--layout all, which is the default of {task}, needs --algo dagger; use it, or choose "
            f"one --layout: {single}"
        )
    return whole


ENTROPY = (0x63686F6F, 0x73696E67)
"""Entropy of the validation seeds, which no `--seed` of `evaluate` gives."""


def validation_seeds(count: int) -> list[int]:
    """Return the seeds of validation episodes; a smaller count gives the first of these seeds."""
    return [int(word) for word in np.random.SeedSequence(ENTROPY).generate_state(count)]


def evaluate_policy(
    policy: Policy,
    task: str,
    layouts: Sequence[str],
    seeds: Sequence[int],
    options: Mapping[str, Any],
    teams: Sequence[Mapping[str, Any]] = (),
    progress: bool = False,
) -> dict[str, float]:
    """Return means of the task's measures on each layout, such as `random_success`.

    Args:
        policy: the policy.
        task: the versioned name.
        layouts: layouts of the task.
        seeds: the seeds of the episodes, the same for each layout.
        options: options of the environments, besides those that the policy requires.
        teams: options of each team; several teams have separate means, such as `random_8_success`
            for eight drones. Without any, `options` define the team.
        progress: True to show a progress bar if it takes more than two seconds.
    """
    agent, learning, found = PolicyAgent(policy), learning_of(task), {}
    flights = [*product(teams or ({},), layouts)]
    bar = tqdm(flights, "evaluating", leave=False, unit="layout", delay=2.0, disable=not progress)
    for team, layout in bar:
        given = {"threads": 1, **learning.layouts[layout], **options, **team, **agent.requires}
        blueprint = batch_of(task, **given)
        core = SwarmCore(blueprint.task, blueprint.config, min(AT_ONCE, len(seeds)))
        metrics = fly_batch(core, agent.act_batch, seeds)
        core.close()
        short = "_".join(map(str, team.values()))
        flown = layout if len(teams) < 2 else f"{layout}_{short}"
        for name, measure in learning.measures.items():
            found[f"{flown}_{name}"] = float(np.mean([measure(m) for m in metrics]))
    return found
