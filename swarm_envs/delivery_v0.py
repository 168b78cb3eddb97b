"""Delivery, version 0."""

from swarm_envs.envs.options import task_views
from swarm_envs.tasks.delivery import DeliveryTask

__doc__ = DeliveryTask.__doc__ or ""
blueprint, parallel_env, env = task_views(DeliveryTask)
