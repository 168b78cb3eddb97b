"""Episodes of agents that act on arrays: many environments at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swarm_envs.agents.protocol import Agent, Observations
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv

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


def disagreement(agent: BatchAgent, observations: Observations) -> str | None:
    """How an agent's two ways to act differ in a decision; None if they do not.

    None also where one raises, or gives what is no action: a flight says more of that.
    """
    rows = np.stack([np.asarray(row) for row in observations.values()])
    try:
        alone = np.stack(list(agent.act(observations, None).values()))
        together = np.asarray(agent.act_batch(rows[None]))[0]
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
    rows = env.core.config.observation == "flat"
    return (
        isinstance(agent, BatchAgent)
        and not agent.privileged
        and rows
        and env.physics_name == "batch"
    )


def fly_batch(core: SwarmCore, act: ActBatch, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Fly one episode a seed, E at a time, and return the metrics of each in order.

    Args:
        core: with the options that the agent requires.
        act: who acts; by observations alone, without memory. It is asked for the environments
            whose episode goes on.
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
