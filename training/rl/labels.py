"""The labels of DAgger: the teacher's actions in the true state of every environment.

A student observes rows, possibly with noise. Its teacher is any agent, and observes more:

- an agent with `act_batch` that is not privileged observes rows of its own form without noise;
- an agent with a method `teach(core)` reads the true state of all environments of a core;
- for any other agent there is an instance for each environment, which acts on its `view`.

The actions of teachers are converted to those of the student: set-points to velocities or
accelerations that lead the student's set-point there, and accelerations to velocities.
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

_CHANGED = 1e-3  # Smallest change of an action by neighbors that counts
_APPROACH, _DAMPING = 4.0, 6.0
"""Gains that lead a set-point to the teacher's: velocity per distance, and acceleration per
velocity, 1/s."""
_STEERED = {"setpoint": ("acceleration", "velocity"), "acceleration": ("velocity",)}
"""Actions of students to which labels can be converted, by those of their teachers."""


@runtime_checkable
class CoreTeacher(Protocol):
    """The protocol of an agent that labels all environments of a core at once."""

    def teach(self, core: SwarmCore) -> FloatArray:
        """Return its actions (E, N, width) in the current true state."""


def teachers_of(teachers: tuple[str, ...], taught: Sequence[tuple[str, int]]) -> list[str]:
    """Return the teacher of each part of the curriculum and team size: the last that matches.

    Raises:
        ValueError: a part has no teacher, or a teacher has no part.
    """
    chosen = [_last_that_fits(teachers, part, drones) for part, drones in taught]
    for k in sorted({*range(len(teachers))} - {*chosen}):
        parts, sizes = (sorted(set(values)) for values in zip(*taught, strict=True))
        raise ValueError(
            f"--dagger.teacher has {teachers[k]!r}, which teaches nothing here: the parts are "
            f"{', '.join(parts)}, the teams have {', '.join(map(str, sizes))} drones, and each is "
            "taught by the last teacher that matches; leave it out, or name it last"
        )
    return [teachers[k].rpartition("=")[2] for k in chosen]


def _last_that_fits(teachers: tuple[str, ...], part: str, drones: int) -> int:
    here = {part, str(drones), ""}
    fit = [k for k, given in enumerate(teachers) if {*given.rpartition("=")[0].split(",")} <= here]
    if not fit:
        raise ValueError(
            f"--dagger.teacher is {teachers}, but none teaches {drones} drones in {part!r}; begin "
            "with a teacher without a layout and a number of drones"
        )
    return fit[-1]


class Teacher:
    """A teacher of the drones of a core.

    Args:
        name: the agent's name for `swarm_envs.agents.load`.
        blueprint: the blueprint of the core.

    Raises:
        ValueError: the agent's actions cannot be converted to the student's, it is privileged and
            has another decision rate, or it needs another controller.
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
        """Return actions (E, N, width) in a core's current state, and their weights (E, N, 1).

        The weight is `avoiding` if the action of a `BatchAgent` would be different without
        neighbors, else 1.
        """
        agent, alone = self._agent, None
        if isinstance(agent, CoreTeacher):
            desired = agent.teach(core)
        elif isinstance(agent, BatchAgent) and not agent.privileged:
            rows = self._rows(core)
            desired = np.clip(agent.act_batch(rows), -1.0, 1.0)
            if avoiding != 1.0 and self._form[0]:
                rows = rows.copy()
                rows[..., neighbor_columns(*self._form)] = 0.0
                alone = np.clip(agent.act_batch(rows), -1.0, 1.0)
        else:
            desired = self._of_each(core)
        weight = np.ones((*desired.shape[:-1], 1), np.float32)
        if alone is not None:
            weight[np.abs(alone - desired).max(axis=-1) > _CHANGED] = avoiding
        if self._action != core.config.action:
            desired = steered(core.world.drones, desired, core.config.action)
        return np.clip(desired, -1.0, 1.0).astype(np.float32), weight

    def _rows(self, core: SwarmCore) -> Float32Array:
        noisy = core.config.hall is not None or (core.ranges is not None and core.ranges.noisy)
        exact = not noisy and not core.config.communicates
        return core.rows if exact and core.form[1:] == self._form else core.true_rows(*self._form)

    def _of_each(self, core: SwarmCore) -> FloatArray:
        """Return actions (E, N, width) of one agent per environment, reset at each episode."""
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
    """Return a stand-in for one environment of a core, with the attributes that resets need."""
    return SimpleNamespace(
        core=core,
        view=view,
        agents=names,
        possible_agents=names,
        observation_layout=observation_layout(*form),
    )


def _check(name: str, agent: Agent, config: Any) -> None:
    """Raise ValueError for an agent whose actions or controller do not match the student's.

    Agents that are not privileged have no memory, and so teach policies of any decision rate.
    """
    requires = agent.requires
    action = requires.get("action", config.action)
    if config.action not in (action, *_STEERED.get(action, ())):
        raise ValueError(
            f"{name!r} cannot teach --action {config.action}, as its own action is {action!r}; use "
            "another teacher"
        )
    rate = requires.get("decision_rate", config.decision_rate)
    if agent.privileged and rate != config.decision_rate:
        raise ValueError(
            f"{name!r} has a decision rate of {rate} Hz and cannot teach a policy of "
            f"{config.decision_rate} Hz; give --decision-rate {rate}"
        )
    default = ControllerConfig()
    if requires.get("controller", config.controller) != config.controller and (
        requires["controller"] or default
    ) != (config.controller or default):
        raise ValueError(
            f"{name!r} needs another controller than this policy and cannot teach it; give "
            f"--controller {name}"
        )


def steered(drones: Records, desired: FloatArray, action: str) -> FloatArray:
    """Return actions (E, N, 3) that lead the drones' set-points to others, or accelerate them.

    Args:
        drones: (E, N) records.
        desired: (E, N, 14) actions of mode `setpoint`, or (E, N, 3) of `acceleration`.
        action: the mode of the result, `velocity` or `acceleration`.
    """
    present = drones["setpoint_velocity"] + ACCELERATION_LAG * drones["setpoint_acceleration"]
    if desired.shape[-1] == present.shape[-1]:
        return np.asarray((present + ACCELERATION_LIMIT * desired / _DAMPING) / SPEED_LIMIT)
    position, velocity, acceleration, jerk = (desired[..., k : k + 3] for k in (0, 3, 6, 9))
    away = position - drones["setpoint_position"]
    coasting = velocity + ACCELERATION_LAG * acceleration + _APPROACH * away
    if action == "velocity":
        return np.asarray(coasting / SPEED_LIMIT)
    commanded = acceleration + ACCELERATION_LAG * jerk + _DAMPING * (coasting - present)
    most = np.abs(commanded).max(axis=-1, keepdims=True) / ACCELERATION_LIMIT
    return np.asarray(commanded / ACCELERATION_LIMIT / np.maximum(most, 1.0))


def neighbor_columns(*form: int) -> slice:
    """Return the columns of neighbors in a row of a form with at least one neighbor."""
    fields = [f for f in observation_layout(*form) if f.name.startswith("neighbor_")]
    return slice(fields[0].where.start, fields[-1].where.stop)
