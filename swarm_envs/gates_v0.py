"""Gates, version 0."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.gates import GatesTask

__doc__ = GatesTask.__doc__ or ""
blueprint, parallel_env, env = task_views(GatesTask)
