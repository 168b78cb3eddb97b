"""The physics engine that a task and its options ask for."""

from __future__ import annotations

from swarm_envs.envs.config import EnvConfig
from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics
from swarm_envs.tasks.base import Task


def make_physics(task: Task, config: EnvConfig, num_envs: int) -> Physics:
    """Build the engine of E environments.

    Raises:
        ValueError: randomised vehicles could not fly.
        ImportError: Bullet is asked for, and not there.
    """
    engine = BulletPhysics if config.engine == "bullet" else BatchPhysics
    gusts, ranges = None, config.randomization
    if ranges is not None:
        ranges.check_team(task.team)
        gusts = (ranges.gust_acceleration, ranges.gust_time_s)
    return engine(
        task.team,
        num_envs,
        config.interactions,
        arena=task.arena,
        battery=config.battery,
        force_rate=config.force_rate,
        gusts=gusts,
        obstacles=task.obstacle_rows,
    )
