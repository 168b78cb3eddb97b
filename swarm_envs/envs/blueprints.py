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


def batch_of(task: str, **options: Any) -> Blueprint:
    """The same for many environments at once: the batched engine flies unless it is told.

    Raises:
        TypeError: an option does not exist; the message names the nearest.
        ValueError: there is no such task, an option has an impossible value, or pictures are
            asked for.
    """
    found = blueprint_of(task, **{"physics": "batch", **options})
    if found.render_mode is not None:
        raise ValueError(
            f"render_mode is {found.render_mode!r}, but environments that fly at once are not "
            "drawn; render a single one: parallel_env(render_mode='rgb_array')"
        )
    return found
