"""Gymnasium's names: `swarm_envs/Swap-v0` and the like, found without an import of ours.

`gymnasium.make("swarm_envs/Swap-v0", num_drones=4)` flies a team as one agent,
`gymnasium.make("swarm_envs/SwapSolo-v0", ...)` one drone of it, and
`gymnasium.make_vec("swarm_envs/Swap-v0", num_envs=1024, ...)` many teams at once.

Gymnasium runs `register` while it is being imported itself: nothing heavy may be imported here.
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
