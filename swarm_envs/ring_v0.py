"""Ring, version 0: `swarm_envs.ring_v1` with the interaction forces of release 0.1.0.

    from swarm_envs import ring_v0
    env = ring_v0.parallel_env()

The force model that is called `learned` here, and is the default, is `learned-v0`, and the integral
of the tracking controller is bounded by 0.05 m. Use this version to compare with results of release
0.1.0; use `ring_v1` for everything else.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from swarm_envs.arguments import typed_options
from swarm_envs.envs.options import task_views
from swarm_envs.ring_v1 import RingOptions
from swarm_envs.tasks.rewards import write_terms_v0
from swarm_envs.tasks.ring import REWARD_WEIGHTS, RingTask


@dataclass(frozen=True)
class RingTaskV0(RingTask):
    """Version 0 of the task."""

    name = "ring_v0"
    default_weights = MappingProxyType({**REWARD_WEIGHTS, "tracking": 3.0})
    velocity_integral_limit = 0.05
    old_filter = True
    write_reward_terms = staticmethod(write_terms_v0)


@typed_options
@dataclass(frozen=True, kw_only=True)
class RingV0Options(RingOptions):
    """Options of version 0: those of version 1."""

    learned = "learned-v0"
    task_type = RingTaskV0


blueprint, parallel_env, env = task_views(RingV0Options)
"""Make what every interface is made from, PettingZoo's parallel environment, and its AEC one."""
