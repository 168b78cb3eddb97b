"""PettingZoo's AEC interface: the drones decide one after another, then all fly at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from swarm_envs.envs.actions import as_actions, check_actions
from swarm_envs.envs.parallel import SwarmParallelEnv


class SwarmTurnEnv(parallel_to_aec_wrapper[str, Any, Any]):
    """A swarm as a PettingZoo AEC environment. Make it with a task's `env()`.

    The team flies on when the last of its drones has decided; until then every drone sees what
    was seen when the first one did. A bad action is refused in the turn of whose it is.
    `unwrapped` is the `SwarmParallelEnv`.
    """

    env: SwarmParallelEnv
    """The parallel environment beneath."""

    def __init__(self, env: SwarmParallelEnv) -> None:
        super().__init__(env)

    def step(self, action: npt.ArrayLike | None) -> None:
        """Decide for the agent whose turn it is; None for one whose episode has ended.

        Raises:
            RuntimeError: the environment is closed.
            ValueError: the action has a wrong shape, is not finite or outside its bounds, or is
                not None after the end. Nothing has changed then.
        """
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            if action is not None:
                raise ValueError(
                    f"the episode of {agent!r} has ended; its only action is None, until reset()"
                )
        else:
            self._check(agent, action)
        super().step(action)

    def _check(self, agent: str, action: npt.ArrayLike | None) -> None:
        self.env.check_running("step")
        core = self.env.core
        others = np.zeros(core.mode.width, dtype=np.bool_)  # the joined type is the action's own
        actions: dict[str, Any] = dict.fromkeys(self.env.agents, others)
        joined = self.env.join(actions | {agent: action})
        shape = (1, core.num_drones, core.mode.width)
        check_actions(core.mode, as_actions(core.mode, joined, shape))
