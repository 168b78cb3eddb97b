"""Gymnasium environments: a whole team as one agent, or one drone of a team."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array, Observation
from swarm_envs.envs.options import blueprint_of
from swarm_envs.envs.parallel import RENDER_MODES, SwarmParallelEnv
from swarm_envs.errors import check_integer
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task

__all__ = ["split_teams"]


def limited(entry: EnvSpec | None, core: SwarmCore, most: int | None = None) -> EnvSpec | None:
    """Return an entry of Gymnasium's registry with the time limit of an environment, in decisions.

    Wrappers such as `TimeAwareObservation` read the limit. It depends on the options: registered
    entries have none, so that Gymnasium does not add its own `TimeLimit`.

    Args:
        entry: the registered entry.
        core: the core of the environment.
        most: a further limit, in decisions, if there is one.
    """
    if entry is None:
        return None
    steps = core.most_decisions
    return replace(entry, max_episode_steps=steps if most is None else min(steps, most))


class _SwarmEnv(gymnasium.Env[Any, npt.NDArray[np.float32]]):
    """Base class of both interfaces, which wrap a parallel environment."""

    _entry: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The environment's entry in Gymnasium's registry, with the time limit in decisions."""
        return self._entry

    @spec.setter
    def spec(self, entry: EnvSpec | None) -> None:
        self._entry = limited(entry, self.parallel.core)

    def __init__(self, task: Task, config: EnvConfig, render_mode: str | None) -> None:
        self.parallel = SwarmParallelEnv(task, config, render_mode)
        self.render_mode = render_mode
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": config.decision_rate}

    def render(self) -> Any:
        """Return a picture of the swarm; see `SwarmParallelEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """Release the physics engine and the renderer."""
        self.parallel.close()


class SwarmJointEnv(_SwarmEnv):
    """All drones as one agent: the drones' observations and actions are concatenated.

    The reward is the mean of the drones' rewards. `info` has `rewards` (N,), `active` (N,), True
    for drones that took part in the decision, and at the end `episode_metrics`. Make it with
    `gymnasium.make("swarm_envs/Swap-v0", ...)`.
    """

    def __init__(
        self, task: Task, config: EnvConfig | None = None, render_mode: str | None = None
    ) -> None:
        given = config or EnvConfig()
        check_flat(given)
        super().__init__(task, given, render_mode)
        shape = (self.core.num_drones, self.core.mode.width)
        edge = 1.0 if self.core.mode.bounded else np.inf
        self.observation_space: spaces.Space[Any] = joint_box(self.core.rows.shape[1:], np.inf)
        self.action_space: spaces.Space[Any] = joint_box(shape, edge)

    @property
    def core(self) -> SwarmCore:
        """The core of the parallel environment."""
        return self.parallel.core

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Begin an episode; see `SwarmParallelEnv.reset`."""
        self.parallel.reset(seed, options)
        super().reset(seed=None if seed is None else int(seed))
        return self._observation(), {}

    def step(self, action: npt.ArrayLike) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Simulate until the next decision.

        Args:
            action: (N * width,) the drones' actions one after another.

        Raises:
            RuntimeError: no episode is running.
            ValueError: the action has a wrong shape or an invalid number.
        """
        self.parallel.check_running()
        result = self.core.step(split_teams(action, self.action_space.shape, self.core))
        terminated, truncated = bool(result.terminated[0]), bool(result.truncated[0])
        rewards = result.rewards[0].copy()
        info: dict[str, Any] = {"rewards": rewards, "active": result.active[0].copy()}
        if terminated or truncated:
            self.parallel.agents = []
            info["episode_metrics"] = self.core.metrics()
        reward = float(rewards.mean())
        return self._observation(), reward, terminated, truncated, info

    def _observation(self) -> Float32Array:
        return self.core.rows[0].reshape(-1).copy()


def check_flat(config: EnvConfig) -> None:
    """Raise ValueError unless observations are flat rows, which fit into one Box."""
    if config.observation != "flat":
        raise ValueError(
            f"observation is {config.observation!r}, but must be 'flat' for a team in one Box; "
            "use parallel_env() for dictionaries"
        )


def joint_box(shape: tuple[int, ...], edge: float) -> spaces.Space[Any]:
    """Return the Box of a team: numbers (N, width), flattened, within [-edge, edge]."""
    return spaces.Box(-edge, edge, (math.prod(shape),), np.float32)


def split_teams(
    actions: npt.ArrayLike, shape: tuple[int, ...] | None, core: SwarmCore
) -> FloatArray:
    """Return joint actions of E teams as an array (E, N, width) for the core.

    Args:
        actions: joint actions of shape `shape`.
        shape: the shape of the action space, (N * width,) or (E, N * width).
        core: the core, for E, N and the width.

    Raises:
        ValueError: the shape is another, or the entries are no numbers.
    """
    try:
        array = np.asarray(actions)
    except ValueError as error:
        raise ValueError(
            f"action is {actions!r:.80}, but must be numbers of shape {shape}"
        ) from error
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise ValueError(
            f"action is {array.dtype} of shape {array.shape}, but must be numbers of shape {shape}"
            f": {core.num_drones} drones with {core.mode.width} numbers each"
        )
    return array.reshape(core.num_envs, core.num_drones, core.mode.width).astype(np.float64)


def make_joint(task: str, render_mode: str | None = None, **options: Any) -> SwarmJointEnv:
    """Return a team as one agent; options as for the task's `parallel_env()`."""
    return SwarmJointEnv(*blueprint_of(task, render_mode=render_mode, **options))


Policy = Callable[[Observation], npt.ArrayLike]
"""A function from a drone's observation to its action."""


class SwarmSoloEnv(_SwarmEnv):
    """One drone of a team as the agent; the other drones are part of the environment.

    Make it with `gymnasium.make("swarm_envs/SwapSolo-v0", ...)`. `info` is the drone's `info` of
    `SwarmParallelEnv`. The episode ends with that of the drone.

    Args:
        task: the task, with its team.
        config: the options.
        render_mode: see `SwarmParallelEnv`.
        drone: index of the drone that the agent controls.
        others: policy of the other drones, from each one's observation to its action; None gives
            them zeros, with which they hover at their starts in `acceleration` and `velocity`.

    Raises:
        TypeError: `others` is not callable.
        ValueError: there is no such drone.
    """

    def __init__(
        self,
        task: Task,
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        drone: int = 0,
        others: Policy | None = None,
    ) -> None:
        super().__init__(task, config or EnvConfig(), render_mode)
        agents = self.parallel.possible_agents
        if check_integer("drone", drone, 0) >= len(agents):
            raise ValueError(f"drone is {drone}, but the team has drones 0 to {len(agents) - 1}")
        if others is not None and not callable(others):
            raise TypeError(
                f"others is {others!r:.80}, but must be a function from an observation to an action"
            )
        self.agent, self.others = agents[drone], others
        self.observation_space: spaces.Space[Any] = self.parallel.observation_space(self.agent)
        self.action_space: spaces.Space[Any] = self.parallel.action_space(self.agent)
        self._seen: dict[str, Observation] = {}

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; see `SwarmParallelEnv.reset`."""
        self._seen, infos = self.parallel.reset(seed, options)
        super().reset(seed=None if seed is None else int(seed))
        return self._seen[self.agent], infos[self.agent]

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate until the next decision, with an action of the drone's action space.

        Raises:
            RuntimeError: no episode is running.
            ValueError: the action has a wrong shape or an invalid number.
        """
        self.parallel.check_running()
        still = np.zeros(self.parallel.core.mode.width, dtype=np.float32)
        actions: dict[str, npt.ArrayLike] = {
            agent: still if self.others is None else self.others(self._seen[agent])
            for agent in self.parallel.agents
        }
        me = self.agent
        actions[me] = action
        self._seen, rewards, ends, cuts, infos = self.parallel.step(actions)
        if ends[me]:
            infos[me]["episode_metrics"] = self.parallel.core.metrics()
            self.parallel.agents = []
        return self._seen[me], rewards[me], ends[me], cuts[me], infos[me]


def make_solo(
    task: str,
    render_mode: str | None = None,
    drone: int = 0,
    others: Policy | None = None,
    **options: Any,
) -> SwarmSoloEnv:
    """Return one drone of a team as the agent; options as for the task's `parallel_env()`."""
    return SwarmSoloEnv(*blueprint_of(task, render_mode=render_mode, **options), drone, others)
