"""A submission in its sandbox as an agent of the grader."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs import make
from swarm_envs.agents import Actions, Observations
from swarm_envs.agents.protocol import check_options_agree
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer, check_name
from swarm_envs.grading.pipes import Array
from swarm_envs.grading.submission import RemoteWork, WorkFailed, printable
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.physics.step import SETPOINTS

OPTIONS = (
    *("action", "decision_rate", "observation"),
    *("num_neighbors", "num_obstacles", "observe_load", "observe_setpoint"),
)
"""Options that a submission may require; the others are part of the assignment."""
LEAST_NEIGHBORS = 8
"""Least number of neighbors in the grader's rows, which also have loads and set-points."""
MOST_NEIGHBORS = 64
"""Largest number of neighbors, or obstacles, that a submission may observe."""
MOST_DECISIONS = 512
"""Number of stored decisions of a submission, for the comparison with other agents."""


def remote_agent(
    work: RemoteWork, made: Mapping[str, Any], flown: Mapping[str, Any], rate: int
) -> RemoteAgent:
    """Return a submission as an agent.

    Args:
        work: its process.
        made: its attributes, which are not trusted.
        flown: the task's name and the options of the environment.
        rate: the least decision rate of the evaluation, Hz; 0 for the submission's own.

    Raises:
        WorkFailed: it requires options that it may not choose, or the true state.
    """
    if made.get("privileged") is True:
        raise WorkFailed(
            "it requires the true state (privileged = True), which submissions do not receive; "
            "use observations"
        )
    try:
        required = _checked(made.get("requires"))
        every = _repeats(required.get("decision_rate"), rate)
        batched = made.get("batched") is True and every == 1
        return (RemoteBatchAgent if batched else RemoteAgent)(work, required, every, flown)
    except (ValueError, TypeError) as error:
        raise WorkFailed(printable(f"cannot be evaluated: {error}")) from error


class RemoteAgent:
    """A submission in its sandbox as an agent of the grader.

    Args:
        work: its process.
        required: the options that it requires, checked.
        every: the number of decisions for which each action is repeated.
        flown: the task's name and the options of the environment, which the process receives.

    Raises:
        ValueError: it requires other values of the environment's options.
    """

    privileged = False

    def __init__(
        self, work: RemoteWork, required: dict[str, Any], every: int, flown: Mapping[str, Any]
    ) -> None:
        self.requires: Mapping[str, Any] = required
        options, self._every = flown["options"], every
        check_options_agree(self, options)
        own = make(flown["task"], **{**options, "physics": "batch", **required})
        self._layout, config = own.observation_layout, own.core.config
        self.requires = {
            **required,
            "decision_rate": config.decision_rate * every,
            "num_neighbors": max(config.num_neighbors, LEAST_NEIGHBORS),
            "observe_load": True,
            "observe_setpoint": own.core.mode.level == SETPOINTS,
        }
        own.close()
        self._where: npt.NDArray[np.intp] = np.zeros(0, np.intp)  # Columns of its fields
        self.decisions: list[tuple[Float32Array, Array]] = []
        """Stored decisions: rows (N, row width) of the environment, and actions (N, width)."""
        self._work, self._flown, self._held = work, flown, Actions()
        self._resets = self._count = self._steps = 0
        self._rng = np.random.default_rng(0)
        self._env: SwarmParallelEnv | None = None

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare the submission for an episode; it receives another, public seed."""
        if not self._resets:
            self._rng = np.random.default_rng(seed)
        self._env, self._steps = env, 0
        columns = {field.name: field.where for field in env.observation_layout}
        self._where = np.concatenate([np.r_[columns[field.name]] for field in self._layout])
        self._work.ask("reset", {"seed": self._resets, **self._flown})
        self._resets += 1

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the submission's actions for the drones' observations."""
        if self._steps % self._every == 0:
            assert self._env is not None
            rows = self._env.core.rows
            actions = self._request("act", rows[0], rows.shape[:2])
            self._keep(rows, actions)
            self._held = dict(zip(self._env.possible_agents, actions[0], strict=True))
        self._steps += 1
        return self._held

    def _request(self, kind: str, rows: Float32Array, teams: tuple[int, ...]) -> Array:
        assert self._env is not None
        shape = (*teams, self._env.core.mode.width)
        seen = [rows[..., self._where]]
        _, given = self._work.ask(kind, {}, seen, 8 * math.prod(shape))
        if len(given) != 1 or given[0].dtype != np.float64:
            raise WorkFailed("gave an invalid answer: no array of actions")
        if kind == "act" and given[0].shape != shape:
            raise WorkFailed(f"returned actions of shape {given[0].shape}, but must return {shape}")
        return given[0]

    def _keep(self, rows: Float32Array, actions: Array) -> None:
        """Store a uniform random sample of decisions, unpredictable for the submission."""
        self._count += 1
        place, team = self._rng.integers((self._count, len(rows)))
        if len(self.decisions) < MOST_DECISIONS:
            self.decisions.append((rows[team].copy(), actions[team].copy()))
        elif place < MOST_DECISIONS:
            self.decisions[place] = rows[team].copy(), actions[team].copy()


class RemoteBatchAgent(RemoteAgent):
    """A submission that acts for many episodes at once."""

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return the submission's actions for the rows of many teams."""
        actions: Any = self._request("batch", rows, rows.shape[:-1])
        self._keep(rows, actions)
        return actions


def _checked(requires: Any) -> dict[str, Any]:
    """Return the options that a submission requires after a check.

    Raises:
        ValueError: they are no mapping, or it may not choose one of them.
    """
    if not isinstance(requires, dict):
        raise ValueError(f"requires is {requires!r:.80}, but must be a mapping of options")
    for name, value in requires.items():
        check_name("required option", name, OPTIONS)
        if name.startswith("num_") and value is not None:
            check_integer(name, value, 0, MOST_NEIGHBORS)
    return requires


def _repeats(own: Any, rate: int) -> int:
    """Return the number of repetitions of an action that gives at least a decision rate."""
    if not isinstance(own, int) or own < 1:  # None, or an invalid value that is refused later
        return 1
    times = range(1, PHYSICS_RATE // own + 1)
    return next((k for k in times if own * k >= rate and PHYSICS_RATE % (own * k) == 0), 1)
