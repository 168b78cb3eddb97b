"""PettingZoo environments for swarms of small quadrotors with downwash between them.

from swarm_envs import swap_v1
env = swap_v1.parallel_env(num_drones=4)

`help(swap_v1)` describes the task, and `help(swap_v1.parallel_env)` every option. Importing the
package registers the tasks with Gymnasium and PettingZoo: `gymnasium.make("swarm_envs/Swap-v1",
num_drones=4)` flies a team as one agent, `gymnasium.make("swarm_envs/SwapSolo-v1", ...)` one drone
of it, `gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=1024, ...)` many teams at once, and
`pettingzoo.make("parallel", "swarm_envs/swap_v1", num_drones=4)` is `swap_v1.parallel_env(...)`.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

import gymnasium
import pettingzoo

from swarm_envs.errors import check_name, check_type

if TYPE_CHECKING:
    from swarm_envs.envs.parallel import SwarmParallelEnv

__version__ = "0.2.0"

TASKS = (
    *("swap_v1", "ring_v1", "formation_v1", "columns_v0", "delivery_v0"),
    *("crowd_v0", "pursuit_v0", "gates_v0"),
)
"""Every task by its versioned name: modules with a `parallel_env()`."""


def task_family(task: str) -> str:
    """The name that all versions of a task share: `swap` for `swap_v1`, and for `swap`."""
    check_type("task", task, str)
    return task.partition("_v")[0]


def gymnasium_name(task: str, suffix: str = "") -> str:
    """`swarm_envs/Swap-v1` for `swap_v1`."""
    family = task_family(task)
    return f"swarm_envs/{family.capitalize()}{suffix}{task.removeprefix(family).replace('_', '-')}"


def register() -> None:
    """Register every task with Gymnasium and, from 1.27 on, PettingZoo, unless it is registered."""
    joint = "swarm_envs.envs.joint"
    for task in TASKS:
        given = {"task": task}
        if gymnasium_name(task) not in gymnasium.registry:
            name, solo = gymnasium_name(task), gymnasium_name(task, "Solo")
            vector = "swarm_envs.envs.vector:make_vector"
            gymnasium.register(name, f"{joint}:make_joint", vector_entry_point=vector, kwargs=given)
            gymnasium.register(solo, f"{joint}:make_solo", kwargs=given)
        if not hasattr(pettingzoo, "register"):
            continue
        known = pettingzoo.parallel_registry  # where an id `x_v0` is kept as `x-v0`
        if f"swarm_envs/{task.replace('_v', '-v')}" not in known:
            pettingzoo.register("parallel", f"swarm_envs/{task}", f"swarm_envs.{task}:parallel_env")
            pettingzoo.register("aec", f"swarm_envs/{task}", f"swarm_envs.{task}:env")


def make(task: str, **options: Any) -> SwarmParallelEnv:
    """Make a task's parallel environment by name.

    Args:
        task: such as `"swap_v1"`.
        **options: as the task's `parallel_env` takes them.

    Raises:
        ValueError: there is no such task; the message names the nearest.
    """
    check_name("task", task, TASKS)
    env: SwarmParallelEnv = importlib.import_module(f"swarm_envs.{task}").parallel_env(**options)
    return env


def __getattr__(name: str) -> ModuleType:
    """Import a task when it is asked for: `import swarm_envs; swarm_envs.swap_v1`."""
    if name not in TASKS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.{name}")


register()

__all__ = ["TASKS", "__version__", "make", "task_family"]
