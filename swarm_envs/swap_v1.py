"""Swap, version 1."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.swap import SwapTask

__doc__ = SwapTask.__doc__ or ""
blueprint, parallel_env, env = task_views(SwapTask)
