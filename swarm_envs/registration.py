"""Gymnasium's names: `swarm_envs/Swap-v0` and the like, found without an import of ours.

`gymnasium.make("swarm_envs/Swap-v0", num_drones=4)` flies a team as one agent,
`gymnasium.make("swarm_envs/SwapSolo-v0", ...)` one drone of it, and
`gymnasium.make_vec("swarm_envs/Swap-v0", num_envs=1024, ...)` many teams at once.
"""

from __future__ import annotations

from typing import Any

import gymnasium

from swarm_envs import TASKS
from swarm_envs.envs.blueprints import blueprint_of
from swarm_envs.envs.joint import SwarmJointEnv
from swarm_envs.envs.solo import Policy, SwarmSoloEnv
from swarm_envs.envs.vector import SwarmVectorEnv


def gymnasium_name(task: str, suffix: str = "") -> str:
    """`swarm_envs/Swap-v0` for `swap_v0`."""
    name, version = task.rsplit("_", 1)
    return f"swarm_envs/{name.capitalize()}{suffix}-{version}"


def register() -> None:
    """Tell Gymnasium every task's names; Gymnasium calls this when it is imported."""
    here = "swarm_envs.registration"
    for task in TASKS:
        gymnasium.register(
            id=gymnasium_name(task),
            entry_point=f"{here}:make_joint",
            vector_entry_point=f"{here}:make_vector",
            kwargs={"task": task},
        )
        gymnasium.register(
            id=gymnasium_name(task, "Solo"), entry_point=f"{here}:make_solo", kwargs={"task": task}
        )


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
    blueprint = blueprint_of(task, **{"physics": "batch", **options})
    return SwarmVectorEnv(blueprint.task, blueprint.config, num_envs, autoreset_mode)
