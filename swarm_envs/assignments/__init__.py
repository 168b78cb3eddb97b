"""The assignments of a course: what each is worth, and the files that a student begins with.

Each has a folder here with a page, a starter that runs, and tests; `swarm-envs assignment start`
copies it, and `swarm-envs grade` gives the points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

__all__ = ["ASSIGNMENTS", "Assignment", "AssignmentName"]

AssignmentName = Literal["controller", "force-model", "swap", "distributed-mpc", "learning"]
"""Assignments by name."""


@dataclass(frozen=True)
class Assignment:
    """What is asked for, and what it is worth."""

    summary: str
    """One line."""
    work: str
    """What is handed in, as `file.py:Class`."""
    metric: str
    """The number that counts, as reports name it."""
    zero: float
    """Its value that is worth nothing."""
    full: float
    """Its value, or better, that is worth 100 points."""
    flown: Mapping[str, Any] = field(default_factory=dict)
    """Options of `swarm-envs evaluate`; empty where nothing is flown in an environment."""
    train_s: float = 0.0
    """Time that the work's `train` is given before the flights, s; 0 if it has none."""

    def points(self, report: Mapping[str, Any]) -> float:
        """Points from 0 to 100; in flights, times the share of episodes without a crash."""
        value = report.get(self.metric)
        if value is None:
            return 0.0
        share = (float(value) - self.zero) / (self.full - self.zero)
        safe = 1.0 - float(report.get("collision_rate", 0.0))
        return round(100.0 * min(max(share, 0.0), 1.0) * safe, 1)

    @property
    def rubric(self) -> str:
        """The rule of the points in one sentence."""
        said = f"{self.metric}: {self.zero:g} gives 0 points, {self.full:g} gives 100"
        crash = ", times the share of episodes without a crash"
        return said if self.metric == "explained" else said + crash


ASSIGNMENTS: Mapping[str, Assignment] = MappingProxyType(
    {
        "controller": Assignment(
            summary="hold three drones at their heights in each other's downwash",
            work="controller.py:MyController",
            metric="worst_height_error_m",
            zero=0.08,
            full=0.015,
            flown={"task": "swap", "layout": "stacked", "drones": 3, "world": "hall"},
        ),
        "force-model": Assignment(
            summary="learn the downwash from flight logs of the hall",
            work="force_model.py:MyModel",
            metric="explained",
            zero=0.25,
            full=0.62,
        ),
        "swap": Assignment(
            summary="make 16 drones of two sizes change places without touching",
            work="swap.py:MyAgent",
            metric="success_rate",
            zero=0.0,
            full=0.95,
            flown={"task": "swap", "layout": "random", "team": "SSSSSSSSLLLLLLLL"},
        ),
        "distributed-mpc": Assignment(
            summary="plan for six drones that hear each other over a lossy radio",
            work="planner.py:MyPlanner",
            metric="success_rate",
            zero=0.0,
            full=0.95,
        ),
        "learning": Assignment(
            summary="learn to swap in one minute of one core",
            work="learner.py:MyLearner",
            metric="success_rate",
            zero=0.3,
            full=0.98,
            flown={"task": "swap", "layout": "random", "drones": 8},
            train_s=60.0,
        ),
    }
)
"""The assignments by their names."""
assert set(get_args(AssignmentName)) == set(ASSIGNMENTS)
