"""The assignments of a course.

Each has a folder here with instructions, starter code and tests, which `swarm-envs assignment
start` copies; `swarm-envs grade` grades submissions.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from swarm_envs.assignments.force import ForceModel
from swarm_envs.assignments.planner import DistributedMpc
from swarm_envs.grading.assignment import Assignment

__all__ = ["ASSIGNMENTS", "Controller", "DistributedMpc", "ForceModel", "Learning", "Swap"]


class Controller(Assignment):
    """Write a controller for three drones that pass below each other, in downwash."""

    name = "controller"
    work = "controller.py:MyController"
    options: ClassVar[Mapping[str, Any]] = {"layout": "stacked", "num_drones": 3, "world": "hall"}
    metric = "worst_tracking_error_m"
    zero, full = 0.08, 0.03
    counted = "that succeed with no error above 0.15 m, so that drones pass below each other"
    rate = 48

    def counts(self, metrics: Mapping[str, Any]) -> bool:
        """Return True if the drones followed their references, which lead below each other."""
        return bool(metrics["success"]) and metrics["worst_tracking_error_m"] < 0.15


class Swap(Assignment):
    """Let 16 drones of two sizes exchange positions without collisions."""

    name = "swap"
    work = "swap.py:MyAgent"
    options: ClassVar[Mapping[str, Any]] = {"layout": "random", "team": "SSSSSSSSLLLLLLLL"}
    metric = "success_rate"
    zero, full = 0.0, 0.95


class Learning(Assignment):
    """Learn to swap in one minute on one core."""

    name = "learning"
    work = "learner.py:MyLearner"
    options: ClassVar[Mapping[str, Any]] = {"layout": "random", "num_drones": 8}
    metric = "success_rate"
    zero, full = 0.3, 0.98
    train_s = 60.0


ASSIGNMENTS: Mapping[str, Assignment] = MappingProxyType(
    {each.name: each for each in (Controller(), ForceModel(), Swap(), DistributedMpc(), Learning())}
)
"""The assignments by name."""
