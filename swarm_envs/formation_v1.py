"""Formation, version 1."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.formation import FormationTask

__doc__ = FormationTask.__doc__ or ""
blueprint, parallel_env, env = task_views(FormationTask)
