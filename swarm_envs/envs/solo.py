"""Gymnasium's interface for one drone of a team, the others flown by a policy that is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.observation import Observation
from swarm_envs.envs.options import blueprint_of
from swarm_envs.envs.parallel import RENDER_MODES, SwarmParallelEnv
from swarm_envs.errors import check_integer
from swarm_envs.tasks.base import Task

Policy = Callable[[Observation], npt.ArrayLike]
"""From one drone's observation to its action."""


class SwarmSoloEnv(gymnasium.Env[Any, npt.NDArray[np.float32]]):
    """One drone's own observations, actions and rewards; the rest of the team belongs to the air.

    Made by `gymnasium.make("swarm_envs/SwapSolo-v0", ...)`. `info` is the drone's of
    `SwarmParallelEnv`.

    Args:
        task: what is flown, by whom.
        config: how.
        render_mode: as of `SwarmParallelEnv`.
        drone: which of the team is flown.
        others: flies the other drones, each from its own observation; None gives them zeros:
            with `acceleration` and `velocity` they rest where they start.

    Raises:
        TypeError: `others` cannot be called.
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
        self.parallel = SwarmParallelEnv(task, config, render_mode)
        agents = self.parallel.possible_agents
        if check_integer("drone", drone, 0) >= len(agents):
            raise ValueError(f"drone is {drone}, but the team has drones 0 to {len(agents) - 1}")
        if others is not None and not callable(others):
            raise TypeError(
                f"others is {others!r:.80}, but must be a function from an observation to an action"
            )
        self.agent, self.others = agents[drone], others
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": self.parallel.core.config.decision_rate,
        }
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
        """Fly until the next decision, with an action of the drone's action space.

        Raises:
            RuntimeError: there is no episode.
            ValueError: the action has a wrong shape, or a number that cannot be.
        """
        still = np.zeros(self.parallel.core.mode.width, dtype=np.float32)
        actions: dict[str, npt.ArrayLike] = {
            agent: still if self.others is None else self.others(self._seen[agent])
            for agent in self.parallel.agents
        }
        if self.parallel.agents:
            actions[self.agent] = action
        self._seen, rewards, ends, cuts, infos = self.parallel.step(actions)
        me = self.agent
        return self._seen[me], rewards[me], ends[me], cuts[me], infos[me]

    def render(self) -> Any:
        """A picture of the swarm; see `SwarmParallelEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """Free what physics and renderer hold."""
        self.parallel.close()


def make_solo(
    task: str,
    render_mode: str | None = None,
    drone: int = 0,
    others: Policy | None = None,
    **options: Any,
) -> SwarmSoloEnv:
    """One drone of a team; options as of the task's `parallel_env()`."""
    return SwarmSoloEnv(*blueprint_of(task, render_mode=render_mode, **options), drone, others)
