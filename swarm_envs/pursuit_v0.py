"""Pursuit, version 0."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.pursuit import PursuitTask

__doc__ = PursuitTask.__doc__ or ""
blueprint, parallel_env, env = task_views(PursuitTask)
