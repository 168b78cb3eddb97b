"""The protocol of agents, one team or many at a time, and the loops that fly their episodes."""

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
"""What every agent observes, by its name."""
Actions = dict[str, npt.NDArray[Any]]
"""What every agent does, by its name."""
StepInfos = dict[str, dict[str, Any]]  # What the environment adds to a step, by agent name


@runtime_checkable
class Agent(Protocol):
    """Anything that flies a team: a scripted baseline, a trained policy, a student's file."""

    requires: Mapping[str, Any]
    """Environment options without which it cannot act: action, decision_rate, controller ..."""
    privileged: bool
    """Whether it wants `view`: the true state, goals and reference."""

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare for an episode of this environment, which has just been reset."""

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Give every agent's action.

        Args:
            observations: of the environment, by agent name.
            view: the truth if the agent is privileged, else None.
        """


def check_requirements(env: SwarmParallelEnv, agent: Agent) -> None:
    """Refuse an environment in which an agent would fly as something else."""
    if isinstance(agent, type) or not isinstance(agent, Agent):
        raise TypeError(
            f"agent is {agent!r:.80}, but must be an object with `requires`, `privileged`, "
            "`reset(env, seed)` and `act(observations, view)`; of a class, make one"
        )
    for name, wanted in agent.requires.items():
        if not hasattr(env.core.config, name):
            valid = [field.name for field in fields(env.core.config)]
            raise ValueError(unknown_name("option", name, valid, f"required by {agent!r:.60}"))
        have = getattr(env.core.config, name)
        if have is not wanted and have != wanted:
            place, mine, theirs = _difference(name, wanted, have)
            raise ValueError(
                f"{type(agent).__name__} requires {place}={mine!r:.80}, but the environment has "
                f"{theirs!r:.80}; make it with parallel_env(..., **agent.requires)"
            )


def _difference(name: str, wanted: Any, have: Any) -> tuple[str, Any, Any]:
    """Return the first field in which two options of a name differ, or the options themselves."""
    if is_dataclass(wanted) and type(have) is type(wanted):
        for field in fields(wanted):
            mine, theirs = getattr(wanted, field.name), getattr(have, field.name)
            if mine != theirs:
                return f"{name}.{field.name}", mine, theirs
    return name, wanted, have


def check_task(agent: Agent, task: Task) -> None:
    """Refuse a task that an agent cannot fly, before there is an environment of it.

    An agent says so by a method `check(task)`, which its `reset` calls too; one without it flies
    every task.

    Raises:
        ValueError: with the agent's reason.
    """
    check = getattr(agent, "check", None)
    if check is not None:
        check(task)


def check_options_agree(agent: Agent, given: Mapping[str, Any]) -> None:
    """Refuse an agent that requires another environment than was asked for.

    Args:
        agent: who is to fly.
        given: options of the environment that were asked for.

    Raises:
        ValueError: an option was given and the agent requires another; the message names it.
    """
    for option, wanted in agent.requires.items():
        if option in given and given[option] != wanted:
            raise ValueError(
                f"it requires {option}={wanted!r}, not {given[option]!r}; leave that option out"
            )


def fly_episode(
    env: SwarmParallelEnv,
    agent: Agent,
    seed: int,
    watch: Callable[[SwarmParallelEnv], None] | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Fly one episode and return its metrics.

    Args:
        env: an environment that has what the agent requires.
        agent: who acts.
        seed: of the episode, for environment and agent.
        watch: called after the reset and after every step.
        options: for the environment's reset.

    Raises:
        ValueError: the environment lacks what the agent requires.
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
    """Fly one episode and return everything that happened, one sample a decision.

    The arguments are those of `fly_episode`, and the agent's name for the record, by default that
    of its class. Write the recording with `swarm_envs.viewing.trajectory.write_trajectory`, look at
    it with `swarm_envs.viewing.replay.write_replay`.
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
    """Fly an episode, stopping after the reset and after each step with its rewards and infos.

    The agent always acts for the whole team: drones that have ended observe zeros, and what it
    says of them is left out.
    """
    check_requirements(env, agent)
    observations, infos = env.reset(seed=seed, options=options)
    agent.reset(env, seed)
    yield {}, infos
    while env.agents:
        actions = agent.act(observations, env.view if agent.privileged else None)
        if len(env.agents) < len(env.possible_agents):
            actions = {agent: actions[agent] for agent in env.agents}
        observations, rewards, _, _, infos = env.step(actions)
        if len(env.agents) < len(env.possible_agents):
            observations = env.split(env.core.rows)
        yield rewards, infos


ActBatch = Callable[[Float32Array], Float32Array]
"""Actions (E, N, width) for observation rows (E, N, row width)."""

AT_ONCE = 64
"""Environments that fly at once."""


@runtime_checkable
class BatchAgent(Agent, Protocol):
    """An agent without memory: what a team does follows from its observation rows alone.

    Nothing of an episode may stay in the agent, and `act` must give what `act_batch` gives of the
    same rows: `evaluate` then flies many episodes at once, with the same metrics.
    """

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Actions (..., N, width) of teams, for their observation rows (..., N, row width)."""


class RowAgent(ABC):
    """Base of agents that act on observation rows alone: subclasses write `act_batch`."""

    privileged = False

    def act(self, observations: Observations, view: View | None) -> Actions:
        """What `act_batch` gives for the rows of the team."""
        actions = self.act_batch(np.stack(list(observations.values())))
        return dict(zip(observations, actions, strict=True))

    @abstractmethod
    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Actions (..., width) for observation rows (..., row width) of any number of drones."""


def disagreement(agent: BatchAgent, observations: Observations) -> str | None:
    """How an agent's two ways to act differ in a decision; None if they do not.

    None also where one raises, or gives what is no action: a flight says more of that.
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
        f"act gives {list(observations)[i]} {alone[i].tolist()}, but act_batch "
        f"{together[i].tolist()} for the same rows; both must give the same"
    )


def flies_batches(env: SwarmParallelEnv, agent: Agent) -> bool:
    """Whether an agent can fly many episodes at once of what this environment flies.

    It acts on arrays and needs no view; the batched engine flies, and rows are observed.
    """
    return (
        isinstance(agent, BatchAgent)
        and not agent.privileged
        and env.core.config.observation == "flat"
        and env.physics_name == "batch"
    )


def fly_batch(core: SwarmCore, act: ActBatch, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Fly one episode a seed, E at a time, and return the metrics of each in order.

    Args:
        core: with the options that the agent requires.
        act: who acts; by observations alone, without memory. It is asked for the environments
            whose episode continues.
        seeds: of the episodes.

    Raises:
        ValueError: actions of a wrong shape, or with a number that cannot be.
    """
    metrics: list[dict[str, Any]] = []
    for first in range(0, len(seeds), core.num_envs):
        chunk = list(seeds[first : first + core.num_envs])
        idle = core.num_envs - len(chunk)
        rows = core.reset([*chunk, *[None] * idle], np.arange(core.num_envs) < len(chunk))
        while core.running.any():
            actions = np.zeros((core.num_envs, core.num_drones, core.mode.width))
            actions[core.running] = _asked(act, rows[core.running], core.mode.width)
            rows = core.step(actions).observations
        metrics += [core.metrics(e) for e in range(len(chunk))]
    return metrics


def _asked(act: ActBatch, rows: Float32Array, width: int) -> Float32Array:
    """What an agent answers, refused if its shape is another: numpy would spread it over teams."""
    given, wanted = act(rows), (*rows.shape[:-1], width)
    if np.shape(given) != wanted:
        raise ValueError(
            f"act_batch gave actions of shape {np.shape(given)} for rows of shape {rows.shape}, "
            f"but must give {wanted}: {width} numbers for every drone of every team"
        )
    return given
