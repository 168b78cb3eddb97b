"""A work that flies, as an agent of the grader."""

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
"""Options that a work may require. All others say what is flown and when it is a success."""
SEEN = 8
"""Neighbors that the grader observes, with loads and set-points, whatever a work asks for."""
MOST_SEEN = 64
"""Neighbors, or obstacles, that it may ask to observe."""
KEPT = 512
"""Decisions of a work that are kept, to be compared with those of others."""


def remote_agent(
    work: RemoteWork, made: Mapping[str, Any], flown: Mapping[str, Any], rate: int = 0
) -> RemoteAgent:
    """Return a work as an agent, by what it says of itself; arguments are those of `RemoteAgent`.

    Raises:
        WorkFailed: it requires what it may not.
    """
    if made.get("privileged") is True:
        raise WorkFailed("it asks for the true state (privileged = True), which no work is shown")
    try:
        every = _repeats(_checked(made.get("requires")).get("decision_rate"), rate)
        batched = made.get("batched") is True and every == 1
        return (RemoteBatchAgent if batched else RemoteAgent)(work, made, flown, rate)
    except (ValueError, TypeError) as error:
        raise WorkFailed(printable(f"cannot be flown: {error}")) from error


class RemoteAgent:
    """A work that flies, as an agent of the grader.

    Args:
        work: its process.
        made: what it says of itself.
        flown: the task's name and the options of the environment, which it is told.
        rate: decisions a second, at least, that are counted; of a work that decides more rarely
            each action is repeated. 0 for its own rate.

    Raises:
        ValueError: it requires what it may not.
    """

    privileged = False

    def __init__(
        self, work: RemoteWork, made: Mapping[str, Any], flown: Mapping[str, Any], rate: int = 0
    ) -> None:
        asked, options = _checked(made.get("requires")), flown["options"]
        self.requires: Mapping[str, Any] = asked
        check_options_agree(self, options)
        own = make(flown["task"], **{**options, "physics": "batch", **asked})
        self._layout, config = own.observation_layout, own.core.config
        self.every = _repeats(asked.get("decision_rate"), rate)
        """The number of decisions for which each action is repeated."""
        self.requires = {
            **asked,
            "decision_rate": config.decision_rate * self.every,
            "num_neighbors": max(config.num_neighbors, SEEN),
            "observe_load": True,
            "observe_setpoint": own.core.mode.level == SETPOINTS,
        }
        own.close()
        self._where: npt.NDArray[np.intp] = np.zeros(0, np.intp)  # Of its fields in rows
        self.kept: list[tuple[Float32Array, Array]] = []
        """Some of its decisions: rows (N, row width) of the environment, and actions (N, width)."""
        self._work, self._flown, self._held = work, flown, Actions()
        self._resets = self._decisions = self._steps = 0
        self._rng = np.random.default_rng(0)
        self._env: SwarmParallelEnv | None = None

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare the work for an episode; of its seed it learns nothing, it is given another."""
        if not self._resets:  # the seed is of the episode, which the work does not know
            self._rng = np.random.default_rng(seed)
        self._env, self._steps = env, 0
        places = {field.name: field.where for field in env.observation_layout}
        self._where = np.concatenate([np.r_[places[field.name]] for field in self._layout])
        self._work.ask("reset", {"seed": self._resets, **self._flown})
        self._resets += 1

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the work's actions for what its drones observe."""
        if self._steps % self.every == 0:
            assert self._env is not None
            rows = self._env.core.rows
            actions = self._asked("act", rows[0], rows.shape[:2])
            self._keep(rows, actions)
            self._held = dict(zip(self._env.possible_agents, actions[0], strict=True))
        self._steps += 1
        return self._held

    def _asked(self, kind: str, rows: Float32Array, teams: tuple[int, ...]) -> Array:
        assert self._env is not None
        shape = (*teams, self._env.core.mode.width)
        seen = [rows[..., self._where]]
        _, given = self._work.ask(kind, {}, seen, 8 * math.prod(shape))
        if len(given) != 1 or given[0].dtype != np.float64:
            raise WorkFailed("answered nonsense: no array of actions")
        if kind == "act" and given[0].shape != shape:
            raise WorkFailed(f"answered actions of shape {given[0].shape}, not {shape}")
        return given[0]

    def _keep(self, rows: Float32Array, actions: Array) -> None:
        """Keep decisions of all flights evenly, of one team each: which, no work can foresee."""
        self._decisions += 1
        place, team = self._rng.integers((self._decisions, len(rows)))
        if len(self.kept) < KEPT:
            self.kept.append((rows[team].copy(), actions[team].copy()))
        elif place < KEPT:
            self.kept[place] = rows[team].copy(), actions[team].copy()


class RemoteBatchAgent(RemoteAgent):
    """A work that flies many episodes at once."""

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Return the work's actions for the rows of many teams."""
        actions: Any = self._asked("batch", rows, rows.shape[:-1])
        self._keep(rows, actions)
        return actions


def _checked(requires: Any) -> dict[str, Any]:
    """Return what a work requires of the environment.

    Raises:
        ValueError: it is no mapping, or requires what it may not choose.
    """
    if not isinstance(requires, dict):
        raise ValueError(f"requires is {requires!r:.80}, but must be a mapping of options")
    for name, value in requires.items():
        check_name("required option", name, OPTIONS)
        if name.startswith("num_") and value is not None:
            check_integer(name, value, 0, MOST_SEEN)
    return requires


def _repeats(own: Any, rate: int) -> int:
    """Return how often an action is repeated, so that decisions are no rarer than a rate."""
    if not isinstance(own, int) or own < 1:  # the environment's own, or one that it refuses
        return 1
    times = range(1, PHYSICS_RATE // own + 1)
    return next((k for k in times if own * k >= rate and PHYSICS_RATE % (own * k) == 0), 1)
