"""The agent protocol, for one team or many at a time, and the loops of their episodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer, unknown_name
from swarm_envs.tasks.base import Task
from swarm_envs.viewing.record import Recorder, Recording

__all__ = ["AT_ONCE", "BatchAgent", "check_options_agree", "flies_batches", "fly_batch"]

Observations = Mapping[str, npt.NDArray[np.float32]]
"""Observations by agent name."""
Actions = dict[str, npt.NDArray[Any]]
"""Actions by agent name."""
StepInfos = dict[str, dict[str, Any]]  # The infos of a step, by agent name


@runtime_checkable
class Agent(Protocol):
    """The protocol of a controller of all drones: a script, a trained policy or a user's class."""

    requires: Mapping[str, Any]
    """Environment options that it requires, such as action, decision_rate or controller."""
    privileged: bool
    """True if it needs `view`: the true state, the goals and the reference."""

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare for an episode of this environment, which has just been reset."""

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the actions of all drones.

        Args:
            observations: the environment's observations by agent name.
            view: the true state if the agent is privileged, else None.
        """


def check_requirements(env: SwarmParallelEnv, agent: Agent) -> None:
    """Raise ValueError if an environment lacks options that an agent requires."""
    if isinstance(agent, type) or not isinstance(agent, Agent):
        raise TypeError(
            f"agent is {agent!r:.80}, but must be an object with `requires`, `privileged`, "
            "`reset(env, seed)` and `act(observations, view)`; give an instance, not a class"
        )
    for name, required in agent.requires.items():
        if not hasattr(env.core.config, name):
            valid = [field.name for field in fields(env.core.config)]
            raise ValueError(unknown_name("option", name, valid, f"required by {agent!r:.60}"))
        have = getattr(env.core.config, name)
        if have is not required and have != required:
            place, mine, theirs = _difference(name, required, have)
            raise ValueError(
                f"the agent requires {place}={mine!r:.80}, but the environment has "
                f"{theirs!r:.80}; make it with parallel_env(..., **agent.requires), or "
                "change agent.requires"
            )


def _difference(name: str, required: Any, have: Any) -> tuple[str, Any, Any]:
    """Return name and values of the first field in which two options differ, or of the options."""
    if is_dataclass(required) and type(have) is type(required):
        for field in fields(required):
            mine, theirs = getattr(required, field.name), getattr(have, field.name)
            if mine != theirs:
                return f"{name}.{field.name}", mine, theirs
    return name, required, have


def check_task(agent: Agent, task: Task) -> None:
    """Raise ValueError if an agent does not support a task, without an environment.

    An agent may have a method `check(task)`, which its `reset` calls too; an agent without it
    supports every task.
    """
    check = getattr(agent, "check", None)
    if check is not None:
        check(task)


def check_options_agree(agent: Agent, given: Mapping[str, Any]) -> None:
    """Raise ValueError if an agent requires other options than were requested.

    Args:
        agent: the agent.
        given: the requested options of the environment.
    """
    for option, required in agent.requires.items():
        if option in given and given[option] != required:
            raise ValueError(
                f"it requires {option}={required!r}, not {given[option]!r}; leave that option out"
            )


def fly_episode(
    env: SwarmParallelEnv,
    agent: Agent,
    seed: int,
    watch: Callable[[SwarmParallelEnv], None] | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Simulate one episode and return its metrics, with `mean_return`.

    `mean_return` is the sum of a drone's rewards, averaged over the drones.

    Args:
        env: an environment with the options that the agent requires.
        agent: the agent.
        seed: the seed of the environment and the agent.
        watch: a function that is called with `env` after the reset and after every step.
        options: the options of the environment's reset.

    Raises:
        ValueError: the environment lacks options that the agent requires.
    """
    check_integer("seed", seed)
    infos: StepInfos = {}
    for _, given in _fly(env, agent, seed, options):
        infos = given
        if watch is not None:
            watch(env)
    metrics: dict[str, Any] = next(iter(infos.values()))["episode_metrics"]
    return metrics


def record_episode(
    env: SwarmParallelEnv,
    agent: Agent,
    seed: int,
    watch: Callable[[SwarmParallelEnv], None] | None = None,
    options: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Recording:
    """Simulate one episode and return its recording, with one sample per decision.

    The arguments are those of `fly_episode`, and the agent's name in the recording, by default
    that of its class. Save the recording with `swarm_envs.viewing.trajectory.write_trajectory`, and
    play it with `swarm_envs.viewing.replay.write_replay`.
    """
    check_integer("seed", seed)
    recorder = Recorder(type(agent).__name__ if name is None else name, seed)
    for rewards, infos in _fly(env, agent, seed, options):
        recorder.take(env, rewards, infos)
        if watch is not None:
            watch(env)
    return recorder.record()


def _fly(
    env: SwarmParallelEnv, agent: Agent, seed: int, options: Mapping[str, Any] | None
) -> Iterator[tuple[Mapping[str, float], StepInfos]]:
    """Simulate an episode; yield rewards and infos after the reset and after each step.

    The agent always acts for the whole team: the observations of drones whose episodes have ended
    are zeros, and their actions are ignored. The metrics of the last infos have `mean_return`.
    """
    check_requirements(env, agent)
    observations, infos = env.reset(seed=seed, options=options)
    returns = dict.fromkeys(env.possible_agents, 0.0)
    agent.reset(env, seed)
    yield {}, infos
    while env.agents:
        actions = agent.act(observations, env.view if agent.privileged else None)
        if len(env.agents) < len(env.possible_agents):
            actions = {agent: actions[agent] for agent in env.agents}
        observations, rewards, _, _, infos = env.step(actions)
        for name, reward in rewards.items():
            returns[name] += reward
        if not env.agents:
            for info in infos.values():
                info["episode_metrics"]["mean_return"] = float(np.mean([*returns.values()]))
        elif len(env.agents) < len(env.possible_agents):
            observations = env.split(env.core.rows)
        yield rewards, infos


ActBatch = Callable[[Float32Array], Float32Array]
"""Function that returns actions (E, N, width) for observation rows (E, N, row width)."""

AT_ONCE = 64
"""Number of environments that are simulated together."""


@runtime_checkable
class BatchAgent(Agent, Protocol):
    """The protocol of an agent without memory, whose actions depend on observation rows only.

    The agent must not store anything of an episode, and `act` must return the same actions as
    `act_batch`. `evaluate` then simulates many episodes together, with the same metrics.
    """

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return actions (..., N, width) for observation rows (..., N, row width) of teams."""


class RowAgent(ABC):
    """Base class of agents without memory; subclasses define `act_batch`."""

    privileged = False

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the actions of `act_batch` for the rows of the team."""
        actions = self.act_batch(np.stack(list(observations.values())))
        return dict(zip(observations, actions, strict=True))

    @abstractmethod
    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return actions (..., width) for observation rows (..., row width) of drones."""


def disagreement(agent: BatchAgent, observations: Observations) -> str | None:
    """Return the message for actions of `act` and `act_batch` that differ; None if they agree.

    The result is also None if one of them raises, as the episode then reports the error.
    """
    rows = np.stack([np.asarray(row) for row in observations.values()])
    try:
        alone = np.stack(list(agent.act(observations, None).values()))
        together = np.asarray(agent.act_batch(np.stack([rows, rows])))[1]  # of two teams
        if alone.shape != together.shape or np.allclose(alone, together, rtol=0.0, atol=1e-3):
            return None
    except (Exception, SystemExit):
        return None
    i = int(np.abs(alone - together).max(axis=1).argmax())
    return (
        f"act returns {alone[i].tolist()} for {list(observations)[i]}, but act_batch "
        f"{together[i].tolist()} for the same rows; both must return the same actions"
    )


def flies_batches(env: SwarmParallelEnv, agent: Agent) -> bool:
    """Return True if many episodes of this environment can be simulated together with an agent.

    The agent must be a `BatchAgent` that is not privileged; the environment must have the physics
    engine `batch` and flat observations.
    """
    return (
        isinstance(agent, BatchAgent)
        and not agent.privileged
        and env.core.config.observation == "flat"
        and env.physics_name == "batch"
    )


def fly_batch(core: SwarmCore, act: ActBatch, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Simulate one episode per seed, E at a time, and return their metrics, as `fly_episode` does.

    Args:
        core: E environments with the options that the agent requires.
        act: the function that returns the actions of the environments whose episodes continue.
        seeds: the seeds of the episodes.

    Raises:
        ValueError: the actions have a wrong shape or an invalid number.
    """
    metrics: list[dict[str, Any]] = []
    for first in range(0, len(seeds), core.num_envs):
        chunk = list(seeds[first : first + core.num_envs])
        idle = core.num_envs - len(chunk)
        rows = core.reset([*chunk, *[None] * idle], np.arange(core.num_envs) < len(chunk))
        returns = np.zeros((core.num_envs, core.num_drones))
        while core.running.any():
            actions = np.zeros((core.num_envs, core.num_drones, core.mode.width))
            actions[core.running] = _checked_actions(act, rows[core.running], core.mode.width)
            rows, rewards, *_ = core.step(actions)
            returns += rewards
        ended = enumerate(returns[: len(chunk)])
        metrics += [{**core.metrics(e), "mean_return": float(row.mean())} for e, row in ended]
    return metrics


def _checked_actions(act: ActBatch, rows: Float32Array, width: int) -> Float32Array:
    """Return an agent's actions after a check of their shape, as numpy would broadcast others."""
    given, required = act(rows), (*rows.shape[:-1], width)
    if np.shape(given) != required:
        raise ValueError(
            f"act_batch returned actions of shape {np.shape(given)} for rows of shape "
            f"{rows.shape}, but must return {required}: {width} numbers for each drone of each team"
        )
    return given
