"""Tasks by name: what an environment of any interface is made from."""

from __future__ import annotations

import importlib
from typing import Any

from swarm_envs import TASKS
from swarm_envs.envs.options import Blueprint
from swarm_envs.errors import check_name


def blueprint_of(task: str, **options: Any) -> Blueprint:
    """What the task's `parallel_env(**options)` is made from.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, or an option has an impossible value.
    """
    check_name("task", task, TASKS)
    found: Blueprint = importlib.import_module(f"swarm_envs.{task}").blueprint(**options)
    return found
