"""Tasks by name: how every interface comes from a name and options to a task and a config."""

from __future__ import annotations

import importlib
from typing import Any

from swarm_envs.envs.config import EnvConfig
from swarm_envs.errors import check_name
from swarm_envs.tasks.base import Task

TASKS = ("swap_v0",)
"""Every task by its versioned name: modules with a `parallel_env()`."""


def task_and_config(task: str, **options: Any) -> tuple[Task, EnvConfig]:
    """What a task's `parallel_env(**options)` would fly, and how.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, or an option has an impossible value.
    """
    check_name("task", task, TASKS)
    found: tuple[Task, EnvConfig] = importlib.import_module(f"swarm_envs.{task}").task_and_config(
        **options
    )
    return found
