"""What a teacher would do in the true state of every environment: the labels of DAgger.

A student observes rows, perhaps noisy ones; its teacher is any agent, and sees more:

- an agent with `act_batch` that is not privileged sees rows of its own form without noise;
- an agent with a method `teach(core)` reads the true state of all environments of a core at once;
- of any other agent there is one for each environment, which acts by its `view`.

Labels of agents that give set-points are the actions that lead the student's set-point there;
those of agents that give accelerations are velocities to a student that gives these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swarm_envs.agents import Agent
from swarm_envs.agents.protocol import BatchAgent
from swarm_envs.agents.registry import load_agent
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.actions import ACCELERATION_LAG
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array, observation_layout
from swarm_envs.envs.options import Blueprint
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.state import FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT

__all__ = ["Teacher", "teachers_of"]

_CHANGED = 1e-3  # Change of an action from which on others count as having caused it
_APPROACH, _DAMPING = 4.0, 6.0
"""With which gains a set-point is led to a teacher's: velocity per distance, and acceleration per
velocity, 1/s."""
_STEERED = {"setpoint": ("acceleration", "velocity"), "acceleration": ("velocity",)}
"""Actions of students to which labels can be converted, by those of their teachers."""


@runtime_checkable
class CoreTeacher(Protocol):
    """An agent that labels all environments of a core at once."""

    def teach(self, core: SwarmCore) -> FloatArray:
        """Its actions (E, N, width) in the present true state."""


def teachers_of(teachers: tuple[str, ...], taught: Sequence[tuple[str, int]]) -> list[str]:
    """Name the teacher of each part of the curriculum and size of teams: the last that fits.

    Raises:
        ValueError: one of them has no teacher, or a teacher has none of them.
    """
    chosen = [_last_that_fits(teachers, part, drones) for part, drones in taught]
    for k in sorted({*range(len(teachers))} - {*chosen}):
        parts, sizes = (sorted(set(values)) for values in zip(*taught, strict=True))
        raise ValueError(
            f"--dagger.teacher has {teachers[k]!r}, which teaches nothing here: the parts are "
            f"{', '.join(parts)}, the teams of {', '.join(map(str, sizes))} drones, and the last "
            "teacher that fits both teaches"
        )
    return [teachers[k].rpartition("=")[2] for k in chosen]


def _last_that_fits(teachers: tuple[str, ...], part: str, drones: int) -> int:
    here = {part, str(drones), ""}
    fit = [k for k, given in enumerate(teachers) if {*given.rpartition("=")[0].split(",")} <= here]
    if not fit:
        raise ValueError(
            f"--dagger.teacher is {teachers}, but none teaches {drones} drones in {part!r}; first "
            "name one without a place before it"
        )
    return fit[-1]


class Teacher:
    """An agent that says what every drone of a core should do.

    Args:
        name: as `swarm_envs.agents.load` takes it.
        blueprint: what the core is made from.

    Raises:
        ValueError: the agent acts otherwise than the student, is privileged and decides at another
            rate, or needs another controller.
    """

    def __init__(self, name: str, blueprint: Blueprint) -> None:
        agent, config = load_agent(name), blueprint.config
        _check(name, agent, config)
        self._name, self._agent = name, agent
        self._action = agent.requires.get("action", config.action)
        env = SwarmParallelEnv(blueprint.task, replace(config, **agent.requires))
        env.reset(seed=0)
        agent.reset(env, 0)
        self._form = env.core.form[1:]
        env.close()
        self._each: list[Agent] = []

    def labels(self, core: SwarmCore, avoiding: float) -> tuple[Float32Array, Float32Array]:
        """Actions (E, N, width) in a core's present state, and the weight (E, N, 1) of each.

        The weight is `avoiding` where the action of an agent on rows would be another without
        neighbors, else 1.
        """
        agent, alone = self._agent, None
        if isinstance(agent, CoreTeacher):
            wanted = agent.teach(core)
        elif isinstance(agent, BatchAgent) and not agent.privileged:
            rows = self._rows(core)
            wanted = np.clip(agent.act_batch(rows), -1.0, 1.0)
            if avoiding != 1.0 and self._form[0]:
                rows = rows.copy()
                rows[..., neighbor_columns(*self._form)] = 0.0
                alone = np.clip(agent.act_batch(rows), -1.0, 1.0)
        else:
            wanted = self._of_each(core)
        weight = np.ones((*wanted.shape[:-1], 1), np.float32)
        if alone is not None:
            weight[np.abs(alone - wanted).max(axis=-1) > _CHANGED] = avoiding
        if self._action != core.config.action:
            wanted = steered(core.world.drones, wanted, core.config.action)
        return np.clip(wanted, -1.0, 1.0).astype(np.float32), weight

    def _rows(self, core: SwarmCore) -> Float32Array:
        exact = core.config.hall is None and not (core.ranges is not None and core.ranges.noisy)
        return core.rows if exact and core.form[1:] == self._form else core.true_rows(*self._form)

    def _of_each(self, core: SwarmCore) -> FloatArray:
        """Actions (E, N, width) of an agent for each environment; a new episode resets it."""
        if not self._each:
            self._each = [load_agent(self._name) for _ in range(core.num_envs)]
        rows, found = self._rows(core), []
        begun = core.world.environments["decisions"] == 0
        names = [f"drone_{i}" for i in range(core.num_drones)]
        for e, agent in enumerate(self._each):
            view = View(core, e)
            if begun[e]:
                agent.reset(_environment(core, view, names, self._form), e)
            given = view if agent.privileged else None
            actions = agent.act(dict(zip(names, rows[e], strict=True)), given)
            found.append([actions[name] for name in names])
        return np.array(found, np.float64)


def _environment(core: SwarmCore, view: View, names: list[str], form: Any) -> Any:
    """What agents look at in an environment at a reset, of one of a core's."""
    return SimpleNamespace(
        core=core,
        view=view,
        agents=names,
        possible_agents=names,
        observation_layout=observation_layout(*form),
    )


def _check(name: str, agent: Agent, config: Any) -> None:
    """Refuse an agent whose actions mean something else to the student's drones.

    Agents on rows judge each row by itself, and so teach policies of any decision rate.
    """
    requires = agent.requires
    action = requires.get("action", config.action)
    if config.action not in (action, *_STEERED.get(action, ())):
        raise ValueError(
            f"{name!r} cannot teach actions of {config.action!r}: its own are {action!r}"
        )
    rate = requires.get("decision_rate", config.decision_rate)
    if agent.privileged and rate != config.decision_rate:
        raise ValueError(
            f"{name!r} decides {rate} times a second and cannot teach a policy that decides "
            f"{config.decision_rate} times; give --decision-rate {rate}"
        )
    default = ControllerConfig()
    if requires.get("controller", config.controller) != config.controller and (
        requires["controller"] or default
    ) != (config.controller or default):
        raise ValueError(
            f"{name!r} needs another controller than this policy and cannot teach it; give "
            f"--controller {name}"
        )


def steered(drones: Records, wanted: FloatArray, action: str) -> FloatArray:
    """Actions (E, N, 3) that lead the set-points of drones to others, or accelerate them.

    Args:
        drones: (E, N) records.
        wanted: (E, N, 14) actions of mode `setpoint`, or (E, N, 3) of `acceleration`.
        action: what the actions are, `velocity` or `acceleration`.
    """
    present = drones["setpoint_velocity"] + ACCELERATION_LAG * drones["setpoint_acceleration"]
    if wanted.shape[-1] == present.shape[-1]:
        return np.asarray((present + ACCELERATION_LIMIT * wanted / _DAMPING) / SPEED_LIMIT)
    position, velocity, acceleration, jerk = (wanted[..., k : k + 3] for k in (0, 3, 6, 9))
    away = position - drones["setpoint_position"]
    coasting = velocity + ACCELERATION_LAG * acceleration + _APPROACH * away
    if action == "velocity":
        return np.asarray(coasting / SPEED_LIMIT)
    asked = acceleration + ACCELERATION_LAG * jerk + _DAMPING * (coasting - present)
    most = np.abs(asked).max(axis=-1, keepdims=True) / ACCELERATION_LIMIT
    return np.asarray(asked / ACCELERATION_LIMIT / np.maximum(most, 1.0))


def neighbor_columns(*form: int) -> slice:
    """Where a row of a form with one neighbor or more has them."""
    fields = [f for f in observation_layout(*form) if f.name.startswith("neighbor_")]
    return slice(fields[0].where.start, fields[-1].where.stop)
