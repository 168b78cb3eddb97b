"""PettingZoo environments for swarms of small quadrotors that blow on each other.

from swarm_envs import swap_v0
env = swap_v0.parallel_env(num_drones=4)

Its import tells Gymnasium and PettingZoo the tasks' names; see `swarm_envs.registration`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from swarm_envs.errors import check_name
from swarm_envs.registration import TASKS, register

if TYPE_CHECKING:
    from swarm_envs.envs.parallel import SwarmParallelEnv

__version__ = "0.1.0"

register()


def make(task: str, **options: Any) -> SwarmParallelEnv:
    """Make a task's parallel environment by name.

    Args:
        task: such as `"swap_v0"`.
        **options: as the task's `parallel_env` takes them.

    Raises:
        ValueError: there is no such task; the message names the nearest.
    """
    check_name("task", task, TASKS)
    env: SwarmParallelEnv = importlib.import_module(f"swarm_envs.{task}").parallel_env(**options)
    return env


__all__ = ["TASKS", "__version__", "make"]
