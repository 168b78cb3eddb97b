"""Every numbered table and figure of the three papers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from swarm_envs.errors import check_name
from swarm_envs.training.reproduce.everything import dmpc_swarm, neural_swarm, rth3d
from swarm_envs.training.reproduce.everything.item import Item

ITEMS: Mapping[str, Item] = {
    item.key: item for item in (*neural_swarm.ITEMS, *dmpc_swarm.ITEMS, *rth3d.ITEMS)
}
"""By paper and name, such as `neural-swarm2/table-3`."""

TITLES: Mapping[str, str] = {
    "neural-swarm2": "Neural-Swarm2: Planning and Control of Heterogeneous Multirotor Swarms using "
    "Learned Interactions",
    "dmpc-swarm": "DMPC-Swarm: Distributed Model Predictive Control on Nano UAV Swarms",
    "rth3d": "Polynomial Time Near-Time-Optimal Multi-Robot Path Planning in Three Dimensions "
    "(RTH3D)",
}
"""The papers by the name that the command takes."""


def choose(keys: Sequence[str]) -> list[Item]:
    """Items by key, in the registry's order; all if none are named.

    Raises:
        ValueError: there is no such item; the message names the nearest.
    """
    for key in keys:
        check_name("item", key, ITEMS)
    return [item for key, item in ITEMS.items() if not keys or key in keys]


def listing() -> str:
    """The items with what they show, or why they cannot be remade, as text."""
    width = max(map(len, ITEMS))
    return "\n".join(
        f"{key.ljust(width)}  {item.shows}"
        + (f" [not remade: {item.missing}]" if item.missing else "")
        for key, item in ITEMS.items()
    )
