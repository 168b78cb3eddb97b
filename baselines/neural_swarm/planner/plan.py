"""The plan of a team: what is to be flown, how it was found, and how good it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.bounds import PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.problem import Plane
from swarm_envs.baselines.neural_swarm.planner.scp import StepRecord
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.baselines.neural_swarm.planner.verify import PlanCheck
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team

STATUSES = ("converged", "time limit", "iteration limit", "not feasible")
"""How planning may end; only the first is a plan that keeps everything."""


@dataclass(frozen=True, eq=False)
class SwarmPlan:
    """Motions of N robots over T steps, and all that should be known about them.

    World frame, SI units. Get one with `plan_swarm`, or from a file with `SwarmPlan.load`.
    """

    team: Team
    """The N vehicles."""
    starts: FloatArray
    """(N, 3) start positions, m."""
    goals: FloatArray
    """(N, 3) goal positions, m."""
    trajectories: Trajectories
    """The motions: states, controls and predicted forces."""
    initial: Trajectories
    """What stage 2 began with: the motions of stage 1, or the guess that was given."""
    bounds: PlanningBounds
    """What the plan was to keep to."""
    plane: Plane
    """In which plane robots move."""
    model_name: str
    """The force model that the planner believed; `none` if it planned unaware of forces."""
    model_fingerprint: str
    """SHA-256 of that model's numbers."""
    seed: int
    """Of everything drawn."""
    status: str
    """One of `STATUSES`."""
    reason: str
    """Why it ended so, in words."""
    check: PlanCheck
    """What came of flying the controls forward on the nonlinear model."""
    search: Mapping[str, Any]
    """What stage 1 says of itself; empty if a guess was given."""
    history: tuple[StepRecord, ...]
    """Every program of stage 2, in order."""
    seconds: Mapping[str, float]
    """Time that each stage took, s."""

    @property
    def converged(self) -> bool:
        """Whether stage 2 has converged and the plan keeps its goals and bounds."""
        return self.status == STATUSES[0]

    @property
    def times(self) -> FloatArray:
        """(T + 1,) times of the knots, s."""
        return self.trajectories.times

    @property
    def states(self) -> FloatArray:
        """(T + 1, N, 6) positions (m) and velocities (m/s) at the knots."""
        return self.trajectories.states

    @property
    def controls(self) -> FloatArray:
        """(T, N, 3) controls u held from knot to knot, m/s^2."""
        return self.trajectories.controls

    @property
    def forces(self) -> FloatArray:
        """(T + 1, N, 3) predicted forces f_a at the knots, N."""
        return self.trajectories.forces

    @property
    def duration(self) -> float:
        """Time from start to goal t_f, s."""
        return self.trajectories.duration

    @property
    def costs(self) -> dict[str, float]:
        """Cost of each stage's motions by eq. (6), the integral of ||u|| over all robots, m/s."""
        return {"stage 1": self.initial.cost, "stage 2": self.trajectories.cost}

    def reference(self, time: float) -> Reference:
        """Where robots should be at a time, s: arrays (N, 3); at rest before and after the plan.

        Between knots a polynomial of fifth order meets position, velocity and the mean of the two
        accelerations at both ends, so that the acceleration is continuous: held, it would jump.
        """
        at = min(max(time, 0.0), self.duration)
        moving = float(0.0 <= time < self.duration)
        parts = [self._curve(at), *(moving * slope(at) for slope in self._slopes)]
        return Reference(*(np.asarray(part) for part in parts))

    @cached_property
    def _curve(self) -> Any:
        from scipy.interpolate import BPoly

        states = self.states.copy()
        states[[0, -1], :, 3:] = 0.0  # the solver leaves a rest of velocity, below its tolerance
        held = np.diff(states[..., 3:], axis=0) / self.trajectories.dt
        acceleration = np.zeros_like(states[..., 3:])
        acceleration[1:-1] = 0.5 * (held[1:] + held[:-1])
        rows = np.stack([states[..., :3], states[..., 3:], acceleration], axis=1)
        return BPoly.from_derivatives(self.times, rows)

    @cached_property
    def _slopes(self) -> tuple[Any, ...]:
        return tuple(self._curve.derivative(order) for order in (1, 2, 3))

    def save(self, path: str | Path) -> None:
        """Write the plan whole or not at all, as `.npz` or `.json`.

        Raises:
            ValueError: another suffix.
            OSError: the file cannot be written.
        """
        from swarm_envs.baselines.neural_swarm.planner.plan_file import write_plan

        write_plan(Path(path), self)

    @classmethod
    def load(cls, path: str | Path) -> SwarmPlan:
        """Read what `save` wrote.

        Raises:
            ValueError: another suffix, or the file is damaged; the message says what is wrong.
            OSError: the file cannot be read.
        """
        from swarm_envs.baselines.neural_swarm.planner.plan_file import read_plan

        return read_plan(Path(path))
