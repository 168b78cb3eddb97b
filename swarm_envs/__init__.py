"""PettingZoo environments for swarms of small quadrotors with downwash between them.

from swarm_envs import swap_v1
env = swap_v1.parallel_env(num_drones=4)

`help(swap_v1)` describes the task, and `help(swap_v1.parallel_env)` its options. Importing the
package registers the tasks with Gymnasium and PettingZoo: `gymnasium.make("swarm_envs/Swap-v1",
num_drones=4)` makes a team as one agent, `gymnasium.make("swarm_envs/SwapSolo-v1", ...)` one drone
of a team, `gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=1024, ...)` a batch of teams, and
`pettingzoo.make("parallel", "swarm_envs/swap_v1", num_drones=4)` is `swap_v1.parallel_env(...)`.
"""

from __future__ import annotations

import importlib
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import gymnasium
import pettingzoo

from swarm_envs.errors import check_type

if TYPE_CHECKING:
    from swarm_envs.envs.parallel import SwarmParallelEnv
    from swarm_envs.tasks.base import Task

OwnTask = TypeVar("OwnTask", bound="Task")

__version__ = "1.0.0"

TASKS = (
    *("swap_v1", "ring_v1", "formation_v1", "columns_v0", "delivery_v0"),
    *("crowd_v0", "pursuit_v0", "gates_v0"),
)
"""The versioned names of all tasks, which are modules with a `parallel_env()`."""


def task_family(task: str) -> str:
    """Return the name of a task without its version: `swap` for `swap_v1`, and for `swap`."""
    check_type("task", task, str)
    return task.partition("_v")[0]


def gymnasium_name(task: str, suffix: str = "") -> str:
    """Return Gymnasium's id of a task: `swarm_envs/Swap-v1` for `swap_v1`."""
    family = task_family(task)
    return f"swarm_envs/{family.capitalize()}{suffix}{task.removeprefix(family).replace('_', '-')}"


def register() -> None:
    """Register all tasks with Gymnasium and, from 1.27 on, PettingZoo, unless they already are."""
    for task in TASKS:
        if gymnasium_name(task) not in gymnasium.registry:
            _register_with_gymnasium(task, task)
        if not hasattr(pettingzoo, "register"):
            continue
        known = pettingzoo.parallel_registry  # which stores an id `x_v0` as `x-v0`
        if f"swarm_envs/{task.replace('_v', '-v')}" not in known:
            pettingzoo.register("parallel", f"swarm_envs/{task}", f"swarm_envs.{task}:parallel_env")
            pettingzoo.register("aec", f"swarm_envs/{task}", f"swarm_envs.{task}:env")


def _register_with_gymnasium(name: str, task: str | type[Task]) -> None:
    joint, vector = "swarm_envs.envs.joint", "swarm_envs.envs.vector:make_vector"
    team, solo, given = gymnasium_name(name), gymnasium_name(name, "Solo"), {"task": task}
    gymnasium.register(team, f"{joint}:make_joint", vector_entry_point=vector, kwargs=given)
    gymnasium.register(solo, f"{joint}:make_solo", kwargs=given)


def make(task: str | type[Task], **options: Any) -> SwarmParallelEnv:
    """Make a task's parallel environment.

    Args:
        task: a name such as `"swap_v1"`; or a custom task: a class, or `"path/to/file.py:Class"`.
        **options: the options of the task's `parallel_env`; for a custom task, the options of all
            tasks and the fields of its class.

    Raises:
        ValueError: there is no such task; the message names the nearest.
    """
    from swarm_envs.envs.options import blueprint_of
    from swarm_envs.envs.parallel import SwarmParallelEnv

    return SwarmParallelEnv(*blueprint_of(task, **options))


def register_task(task: type[OwnTask]) -> type[OwnTask]:
    """Register a custom task with Gymnasium and PettingZoo; a decorator of its class.

    `@register_task` above `class LineTask(Task)` registers the ids `swarm_envs/Line-v0` and
    `swarm_envs/LineSolo-v0` with Gymnasium, and `swarm_envs/line_v0` with PettingZoo.

    Raises:
        ValueError: it is no task, or has the name of a task of the package or of another class.
    """
    from swarm_envs.envs.options import task_class

    task_class(task)
    if task.name in TASKS:
        raise ValueError(
            f"name of {task.__name__} is {task.name!r}, which is a task of the package; give it "
            f"another name, such as name = {task.__name__.lower() + '_v0'!r}"
        )
    before = gymnasium.registry.get(gymnasium_name(task.name))
    owner = getattr(before and before.kwargs.get("task"), "__qualname__", "another environment")
    if before is not None and owner != task.__qualname__:
        raise ValueError(
            f"name of {task.__name__} is {task.name!r}, which is registered for {owner}; give one "
            "of them another name"
        )
    for suffix in ("", "Solo"):
        gymnasium.registry.pop(gymnasium_name(task.name, suffix), None)  # from an earlier import
    _register_with_gymnasium(task.name, task)
    if hasattr(pettingzoo, "register"):
        pettingzoo.parallel_registry.pop(f"swarm_envs/{task.name.replace('_v', '-v')}", None)
        pettingzoo.register("parallel", f"swarm_envs/{task.name}", partial(make, task))
    return task


def __getattr__(name: str) -> ModuleType:
    """Import a task's module at its first use: `import swarm_envs; swarm_envs.swap_v1`."""
    if name not in TASKS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.{name}")


register()

__all__ = ["TASKS", "__version__", "make", "register_task", "task_family"]
