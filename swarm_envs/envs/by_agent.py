"""Between a dictionary with an entry for each drone and the arrays of the core."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.envs.actions import ActionMode
from swarm_envs.envs.core import StepResult, SwarmCore
from swarm_envs.errors import unknown_name
from swarm_envs.physics.contact import NO_DRONE, NO_OBSTACLE

_NO_CONTACT: dict[str, Any] = {"drone": None, "floor": False, "wall": False, "obstacle": None}


def join_actions(
    mode: ActionMode, agents: Sequence[str], actions: Mapping[str, npt.ArrayLike]
) -> npt.NDArray[np.float64]:
    """Agents' actions as the core takes them: (1, N, width).

    Raises:
        TypeError: they are no mapping.
        ValueError: one is missing, superfluous, of wrong shape or no numbers.
    """
    if not isinstance(actions, Mapping):
        raise TypeError(
            f"actions are {type(actions).__name__}, but must be a dict with an action for each of "
            "env.agents"
        )
    rows = [actions[agent] for agent in agents if agent in actions]
    if not len(rows) == len(agents) == len(actions):
        _refuse_agents(agents, actions)
    try:
        joined = np.array(rows)
    except (ValueError, TypeError):
        joined = np.empty(0)
    if joined.shape != (len(rows), mode.width):
        for agent, row in zip(agents, rows, strict=True):
            if np.shape(row) != (mode.width,):
                raise ValueError(
                    f"action of {agent!r} has shape {np.shape(row)}, but action {mode.name!r} "
                    f"takes {mode.width} numbers: shape ({mode.width},)"
                )
    if joined.dtype.kind not in "fiu":
        raise ValueError(
            f"actions are of type {joined.dtype}, but must be numbers, such as float32"
        )
    return joined[None].astype(np.float64)


def _refuse_agents(agents: Sequence[str], actions: Mapping[str, npt.ArrayLike]) -> None:
    for agent in actions:
        if agent not in agents:
            raise ValueError(unknown_name("agent", agent, agents, "in actions"))
    missing = [agent for agent in agents if agent not in actions]
    raise ValueError(f"actions lack {missing}; give one for each of env.agents")


def infos_by_agent(
    core: SwarmCore, agents: Sequence[str], result: StepResult, ended: bool
) -> dict[str, dict[str, Any]]:
    """What a step of the only environment of a core tells each of all its agents.

    Args:
        core: has just stepped.
        agents: names, in the order of the team.
        result: of the step.
        ended: whether the episode did: then metrics are told.
    """
    # Whatever is touched ends the episode, so that until then nothing is.
    names, columns = core.task.reward_names, result.reward_terms[:, 0].T.tolist()
    infos: dict[str, dict[str, Any]] = {
        agent: {
            "reward_terms": dict(zip(names, column, strict=True)),
            "contact": _NO_CONTACT.copy(),
        }
        for agent, column in zip(agents, columns, strict=True)
    }
    if ended:
        for info, contact in zip(infos.values(), _contacts(core, agents), strict=True):
            info["contact"], info["episode_metrics"] = contact, core.metrics()
    return infos


def _contacts(core: SwarmCore, agents: Sequence[str]) -> list[dict[str, Any]]:
    """What each drone touched in the last decision, which ended the episode if it was anything."""
    contacts = core.physics.contacts
    touched, obstacle = contacts.drone[0].tolist(), contacts.obstacle[0].tolist()
    floor, wall = contacts.floor[0].tolist(), contacts.wall[0].tolist()
    return [
        {
            "drone": None if other == NO_DRONE else agents[other],
            "floor": on_floor,
            "wall": at_wall,
            "obstacle": None if hit == NO_OBSTACLE else hit,
        }
        for other, on_floor, at_wall, hit in zip(touched, floor, wall, obstacle, strict=True)
    ]
