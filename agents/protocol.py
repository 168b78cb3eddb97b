"""The protocol of things that act, and the loop that flies them through an episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import unknown_name
from swarm_envs.viewing.record import Recorder, Recording

Observations = Mapping[str, npt.NDArray[np.float32]]
"""What every agent observes, by its name."""
Actions = dict[str, npt.NDArray[Any]]
"""What every agent does, by its name."""
StepInfos = dict[str, dict[str, Any]]
"""What the environment adds to a step, by agent name."""


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
    """Refuse an environment in which an agent would fly as something else.

    Raises:
        TypeError: it is no agent, but perhaps an agent's class.
        ValueError: an option that the agent requires has another value, or does not exist; the
            message names it.
    """
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
            raise ValueError(
                f"{type(agent).__name__} requires {name}={wanted!r:.80}, but the environment has "
                f"{have!r:.80}; make it with parallel_env(..., **agent.requires)"
            )


def check_wishes(agent: Agent, given: Mapping[str, Any]) -> None:
    """Refuse an agent that requires another environment than was asked for.

    Args:
        agent: who is to fly.
        given: options of the environment that were asked for.

    Raises:
        ValueError: an option was given and the agent requires another; the message names it.
    """
    for option, wanted in agent.requires.items():
        if option in given and given[option] != wanted:
            raise ValueError(f"it requires {option}={wanted!r}, not {given[option]!r}")


@typed
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
    infos: StepInfos = {}
    for _, given in _fly(env, agent, seed, options):
        infos = given
        if watch is not None:
            watch(env)
    metrics: dict[str, Any] = next(iter(infos.values()))["episode_metrics"]
    return metrics


@typed
def record_episode(
    env: SwarmParallelEnv,
    agent: Agent,
    seed: int,
    watch: Callable[[SwarmParallelEnv], None] | None = None,
    options: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Recording:
    """Fly one episode and return everything that happened, one sample a decision.

    Write it with `swarm_envs.viewing.trajectory.write_trajectory`, look at it with
    `swarm_envs.viewing.replay.write_replay`.

    Args:
        env: an environment that has what the agent requires.
        agent: who acts.
        seed: of the episode, for environment and agent.
        watch: called after the reset and after every step.
        options: for the environment's reset.
        name: of the agent, for the record; None for that of its class.

    Raises:
        ValueError: the environment lacks what the agent requires.
    """
    recorder = Recorder(type(agent).__name__ if name is None else name, seed)
    for rewards, infos in _fly(env, agent, seed, options):
        recorder.take(env, rewards, infos)
        if watch is not None:
            watch(env)
    return recorder.record()


def _fly(
    env: SwarmParallelEnv, agent: Agent, seed: int, options: Mapping[str, Any] | None
) -> Iterator[tuple[Mapping[str, float], StepInfos]]:
    """Fly an episode, stopping after the reset and after each step with its rewards and infos."""
    check_requirements(env, agent)
    observations, infos = env.reset(seed=seed, options=options)
    agent.reset(env, seed)
    yield {}, infos
    while env.agents:
        actions = agent.act(observations, env.view if agent.privileged else None)
        observations, rewards, _, _, infos = env.step(actions)
        yield rewards, infos
