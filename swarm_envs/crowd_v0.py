"""Crowd, version 0."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.crowd import CrowdTask

__doc__ = CrowdTask.__doc__ or ""
blueprint, parallel_env, env = task_views(CrowdTask)
