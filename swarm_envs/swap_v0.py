"""Swap, version 0: `swarm_envs.swap_v1` with the interaction forces of release 0.1.0.

    from swarm_envs import swap_v0
    env = swap_v0.parallel_env()

The force model that is called `learned` here, and is the default, is `learned-v0`, and the integral
of the tracking controller is bounded by 0.05 m. Use this version to compare with results of release
0.1.0; use `swap_v1` for everything else.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from swarm_envs.arguments import typed_options
from swarm_envs.envs.options import task_views
from swarm_envs.swap_v1 import SwapOptions
from swarm_envs.tasks.rewards import write_terms_v0
from swarm_envs.tasks.swap import REWARD_WEIGHTS, SwapTask


@dataclass(frozen=True)
class SwapTaskV0(SwapTask):
    """Version 0 of the task."""

    name = "swap_v0"
    default_weights = MappingProxyType({**REWARD_WEIGHTS, "at_goal": 2.0})
    velocity_integral_limit = 0.05
    old_filter = True
    write_reward_terms = staticmethod(write_terms_v0)


@typed_options
@dataclass(frozen=True, kw_only=True)
class SwapV0Options(SwapOptions):
    """Options of version 0: those of version 1."""

    learned = "learned-v0"
    task_type = SwapTaskV0


blueprint, parallel_env, env = task_views(SwapV0Options)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
