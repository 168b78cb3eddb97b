"""Columns, version 0."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.columns import ColumnsTask

__doc__ = ColumnsTask.__doc__ or ""
blueprint, parallel_env, env = task_views(ColumnsTask)
