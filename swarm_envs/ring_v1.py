"""Ring, version 1."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.ring import RingTask

__doc__ = RingTask.__doc__ or ""
blueprint, parallel_env, env = task_views(RingTask)
