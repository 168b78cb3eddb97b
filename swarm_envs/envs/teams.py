"""Which team flies an episode: the constructor's, or another that its reset names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarm_envs.tasks.base import Task
from swarm_envs.vehicles import Team

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


def task_for(core: SwarmCore, team: Team | None) -> Task:
    """The task of episodes that begin now, flown by a team; None for the constructor's.

    Raises:
        ValueError: the team has another number of drones, or holds one that the task, the air, the
            controller's belief or the ranges of randomisation cannot take; nothing has changed.
    """
    if team is None or team == core.task.team:
        return core.task
    if len(team) != core.num_drones:
        raise ValueError(
            f"reset option 'team' has {len(team)} vehicles, but this environment has "
            f"{core.num_drones} drones; make another environment for another number"
        )
    core.physics.interactions.type_indices(team)
    core.flight.belief.type_indices(team)
    if core.config.randomization is not None:
        core.config.randomization.check_team(team)
    return core.task.with_team(team)


def fly_task(core: SwarmCore, e: int, task: Task) -> None:
    """Let environment `e` fly a task of `task_for`, with its team, from the next reset on."""
    if core.tasks[e].team != task.team:
        core.flight.set_team(e, task.team)
        core.observer.set_team(e, task.team)
    core.tasks[e] = task
