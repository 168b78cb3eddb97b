"""The tasks' names in the registries of Gymnasium and PettingZoo.

`gymnasium.make("swarm_envs/Swap-v0", num_drones=4)` flies a team as one agent,
`gymnasium.make("swarm_envs/SwapSolo-v0", ...)` one drone of it, and
`gymnasium.make_vec("swarm_envs/Swap-v0", num_envs=1024, ...)` many teams at once.

Gymnasium finds these without an import of ours: it runs `register` while it is being imported
itself, so nothing heavy may be imported here. PettingZoo looks for no packages: it knows a task
once its module has been imported, `from swarm_envs import swap_v0`; then
`pettingzoo.make("parallel", "swarm_envs/swap_v0", num_drones=4)` makes it.
"""

from __future__ import annotations

from swarm_envs import TASKS


def gymnasium_name(task: str, suffix: str = "") -> str:
    """`swarm_envs/Swap-v0` for `swap_v0`."""
    name, version = task.rsplit("_", 1)
    return f"swarm_envs/{name.capitalize()}{suffix}-{version}"


def register() -> None:
    """Tell Gymnasium every task's names."""
    from gymnasium.envs import registration  # it is half imported when this module is

    makers = "swarm_envs.envs.named"
    for task in TASKS:
        registration.register(
            id=gymnasium_name(task),
            entry_point=f"{makers}:make_joint",
            vector_entry_point=f"{makers}:make_vector",
            kwargs={"task": task},
        )
        registration.register(
            id=gymnasium_name(task, "Solo"),
            entry_point=f"{makers}:make_solo",
            kwargs={"task": task},
        )


def register_with_pettingzoo(task: str) -> None:
    """Tell PettingZoo a task's name, for its parallel and its AEC interface.

    PettingZoo has a registry from version 1.27 on; before, this does nothing.
    """
    import pettingzoo

    add = getattr(pettingzoo, "register", None)
    if add is None:
        return
    add("parallel", f"swarm_envs/{task}", f"swarm_envs.{task}:parallel_env")
    add("aec", f"swarm_envs/{task}", f"swarm_envs.{task}:env")
