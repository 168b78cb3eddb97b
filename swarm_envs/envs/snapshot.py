"""Snapshots: everything that changes while environments fly, to go back to or to hand on."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.envs.teams import fly_task, task_for
from swarm_envs.vehicles import Team

if TYPE_CHECKING:
    from swarm_envs.envs.config import EnvConfig
    from swarm_envs.envs.core import SwarmCore
    from swarm_envs.tasks.base import Task

Arrays = dict[str, npt.NDArray[Any]]
"""Arrays by name, as a snapshot holds them."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The whole state of E environments at one instant; picklable, independent of where it is from.

    Get one from `get_state()`. An environment with the same options that it is given to continues
    byte for byte as the first one did.
    """

    kind: dict[str, object]
    """What it fits: task, team, engine, action, number of environments."""
    arrays: Arrays
    """Every array that changes over time, by name, such as `state.position`: (E, ...)."""
    generators: tuple[Any, ...]
    """State of each environment's random generator."""
    teams: tuple[Team, ...]
    """Who flies in each environment: the team, or another that its reset named."""


def living_arrays(core: SwarmCore) -> Arrays:
    """Every array of a core that changes over time: its own storage, not copies."""
    world, flight = core.physics.world, core.flight
    groups: dict[str, NamedTuple] = {
        "state": world.state,
        "parameters": world.parameters,
        "contacts": world.contacts,
        "setpoint": flight.pilot.setpoint,
        "memory": flight.pilot.memory,
        "tally": flight.tally,
        "mission": core.mission,
        "record": core.record,
        "verdict": core.verdict,
    }
    arrays: Arrays = {
        f"{group}.{name}": array
        for group, values in groups.items()
        for name, array in zip(values._fields, values, strict=True)
    }
    arrays |= {name: getattr(world, name) for name in ("force", "outside", "age", "rotor_limit")}
    arrays |= {name: getattr(flight.pilot, name) for name in ("belief_force", "commands")}
    arrays |= {name: getattr(core, name) for name in ("decisions", "time", "running")}
    arrays |= {"gusts.acceleration": world.gusts.acceleration, "gusts.key": world.gusts.key}
    arrays |= {"asked": flight.pilot.asked, "force_scale": world.force_scale}
    return arrays | {"noise_key": core.observer.noise_key, "observations": core.rows}


def take_snapshot(core: SwarmCore) -> Snapshot:
    """Copy all that changes."""
    return Snapshot(
        kind=_kind(core),
        arrays={name: array.copy() for name, array in living_arrays(core).items()},
        generators=tuple(_generator_state(g) for g in core.generators),
        teams=tuple(task.team for task in core.tasks),
    )


def restore_snapshot(core: SwarmCore, snapshot: Snapshot) -> None:
    """Go to where a snapshot was taken.

    Raises:
        TypeError: it is no snapshot.
        ValueError: it was taken of another task, team, engine, action or number of environments.
    """
    if not isinstance(snapshot, Snapshot):
        raise TypeError(
            f"state is a {type(snapshot).__name__}, but must be what get_state() returned"
        )
    mine = _kind(core)
    for name, value in mine.items():
        if snapshot.kind[name] != value:
            raise ValueError(
                f"the state was taken of an environment whose {name} is {snapshot.kind[name]!r}, "
                f"but here it is {value!r}; make an environment with the same options"
            )
    tasks = {team: task_for(core, team) for team in set(snapshot.teams)}
    for e, team in enumerate(snapshot.teams):
        fly_task(core, e, tasks[team])
    for name, array in living_arrays(core).items():
        array[...] = snapshot.arrays[name]
    for e, state in enumerate(snapshot.generators):
        generator = np.random.default_rng(0)
        generator.bit_generator.state = copy.deepcopy(state)
        core.generators[e] = generator
    core.physics.place_bodies(np.ones(core.num_envs, dtype=np.bool_))


def rebuild(
    kind: type[SwarmCore], task: Task, config: EnvConfig, num_envs: int, snapshot: Snapshot
) -> SwarmCore:
    """Make a core anew where another stood; what `pickle` and `copy` call."""
    core = kind(task, config, num_envs)
    core.set_state(snapshot)
    return core


def _generator_state(generator: np.random.Generator) -> Any:
    state: Any = generator.bit_generator.state
    return copy.deepcopy(state)


def _kind(core: SwarmCore) -> dict[str, object]:
    return {
        "task": core.task.name,
        "team": tuple(vehicle.token for vehicle in core.task.team),
        "physics": core.physics.name,
        "action": core.config.action,
        "num_neighbors": core.config.num_neighbors,
        "num_obstacles": core.num_obstacles,
        "number of environments": core.num_envs,
    }
