"""What Gymnasium calls to make an environment that it knows by name; see `registration`."""

from __future__ import annotations

from typing import Any

from swarm_envs.envs.blueprints import batch_of, blueprint_of
from swarm_envs.envs.joint import SwarmJointEnv
from swarm_envs.envs.solo import Policy, SwarmSoloEnv
from swarm_envs.envs.vector import SwarmVectorEnv


def make_joint(task: str, render_mode: str | None = None, **options: Any) -> SwarmJointEnv:
    """A team as one agent; options as of the task's `parallel_env()`."""
    return SwarmJointEnv(*blueprint_of(task, render_mode=render_mode, **options))


def make_solo(
    task: str,
    render_mode: str | None = None,
    drone: int = 0,
    others: Policy | None = None,
    **options: Any,
) -> SwarmSoloEnv:
    """One drone of a team; options as of the task's `parallel_env()`."""
    return SwarmSoloEnv(*blueprint_of(task, render_mode=render_mode, **options), drone, others)


def make_vector(
    task: str, num_envs: int = 1, autoreset_mode: Any = "NextStep", **options: Any
) -> SwarmVectorEnv:
    """E teams on the batched engine; options as of the task's `parallel_env()`."""
    blueprint = batch_of(task, **options)
    return SwarmVectorEnv(blueprint.task, blueprint.config, num_envs, autoreset_mode)
