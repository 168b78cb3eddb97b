"""All that changes while environments fly, by the names that the tables give it."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from swarm_envs.envs.core import SwarmCore

Arrays = dict[str, npt.NDArray[Any]]


def living(core: SwarmCore) -> Arrays:
    """Copies of every array (E, ...) of a core that changes, by names such as `drones.position`."""
    world = core.world
    tables = {"drones": world.drones, "environments": world.environments}
    found: Arrays = {
        f"{table}.{name}": records[name].copy()
        for table, records in tables.items()
        for name in records.dtype.names or ()
    }
    return found | {"goals": world.goals.copy(), "observations": core.rows.copy()}
