"""The agents of Neural-Swarm2: the tracking controller (Sec. VI) and the planner (Sec. V).

Both return setpoints, which the environment's tracking loop follows with the configuration that the
agent requires. `TrackingAgent` returns the task's reference; `PlanAgent` plans when goals are set,
and returns its plan. They compensate the force predicted by a deep set that was fitted to flights
in the environment, never the environment's own model. Without it the controller is the paper's
baseline, identical in everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from swarm_envs.agents.scripted import DetourAgent, PlannedAgent, SetpointAgent
from swarm_envs.baselines.neural_swarm.planner.pipeline import plan_swarm
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import (
    FORCE_BOUNDS_G,
    PlanningBounds,
    hover_force,
    shortest_time,
)
from swarm_envs.control.config import ControllerConfig, Indi
from swarm_envs.envs.view import View
from swarm_envs.errors import check_integer, check_type
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT, Task
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import GRAM_FORCE, Team

__all__ = ["BELIEFS", "load_belief"]

BELIEFS: Mapping[str, str] = {"learned": "belief", "wake": "belief_wake"}
"""The files of the shipped deep sets, by the environment's force model of their flights."""
MAX_DRONES = 6
"""The most drones of a plan: with more, sequential planning is slow and finds no paths."""
_LONGEST_S = 6.0  # The longest plan; more time makes it hardly cheaper
_SPARE_S = 1.5  # The time left for settling at the goals
_CLEARANCE = 1.6  # Clearance over the sum of radii if starts and goals allow it (near miss: 1.5)
_HOVER_SHARE = 1.2  # Force bound over the force when hovering, where that exceeds the paper's


def load_belief(truth: str = "learned") -> InteractionModel:
    """Return the deep set of the compensated controller and the planner.

    It was fitted to simulated flights; `weights/MODEL_CARD.md` has the flights and the errors.

    Args:
        truth: The name of the environment's force model of these flights.

    Raises:
        ValueError: No deep set is shipped for that model.
    """
    if truth not in BELIEFS:
        raise ValueError(
            f"no belief ships for an environment with the force model {truth!r}, only for "
            f"{' and '.join(BELIEFS)}; fit one to flights there by `python -m "
            f"swarm_envs.training.belief --collection.interactions {truth} --out DIR`, and load "
            "its weights"
        )
    return _load_shipped(BELIEFS[truth])


@cache
def _load_shipped(name: str) -> InteractionModel:
    weights = resources.files("swarm_envs.baselines.neural_swarm").joinpath("weights")
    with resources.as_file(weights.joinpath(f"{name}.safetensors")) as path:
        return load(Path(path))


class TrackingAgent(SetpointAgent):
    """Follows the task's reference with the tracking loop of Neural-Swarm2.

    Args:
        controller: The configuration of the loop; None for the paper's uncompensated baseline.
        decision_rate: The number of setpoints per second.
    """

    def __init__(self, controller: ControllerConfig | None = None, decision_rate: int = 48) -> None:
        check_type("controller", controller, ControllerConfig | None)
        check_integer("decision_rate", decision_rate)
        given = controller or ControllerConfig()
        super().__init__(
            {"action": "setpoint", "decision_rate": decision_rate, "controller": given}
        )

    @classmethod
    def compensated(cls) -> TrackingAgent:
        """Return the agent that feeds forward the force of `load_belief()`."""
        return cls(ControllerConfig(feedforward=load_belief()))

    @classmethod
    def adaptive(cls) -> TrackingAgent:
        """Return the agent that estimates the force in flight by `Indi`, without a model."""
        return cls(ControllerConfig(adaptation=Indi()))

    @classmethod
    def compensated_adaptive(cls) -> TrackingAgent:
        """Return the agent that feeds a model's force forward and estimates the residual."""
        return cls(ControllerConfig(feedforward=load_belief(), adaptation=Indi()))

    def reference(self, view: View) -> Reference:
        """Return the task's reference at this time."""
        return view.reference(view.time)


def compensated_detour() -> DetourAgent:
    """Return a `DetourAgent` that feeds forward the force of `load_belief()`."""
    return DetourAgent(ControllerConfig(feedforward=load_belief()))


class PlanAgent(PlannedAgent[SwarmPlan]):
    """Plans at every change of goals with its own model of the forces, and follows the plan.

    Args:
        belief: The force model of planner and controller; None for `load_belief()`.
    """

    def __init__(self, belief: InteractionModel | None = None) -> None:
        self._model = belief or load_belief()
        super().__init__(TrackingAgent(ControllerConfig(feedforward=self._model)).requires)

    def check(self, task: Task) -> None:
        """Raise ValueError for a task that it cannot plan."""
        super().check(task)
        if len(task.team) > MAX_DRONES:
            raise ValueError(
                f"PlanAgent got {len(task.team)} drones, but plans for at most {MAX_DRONES}; for "
                "more use an agent without joint planning, such as 'tracking+compensated'"
            )
        if task.obstacles:
            raise ValueError(
                f"PlanAgent cannot avoid obstacles, but the task has {len(task.obstacles)}; make "
                "the environment without"
            )

    def plan(self, task: Task, view: View, seed: int) -> SwarmPlan:
        """Return a plan that bounds the predicted forces; it may not have converged."""
        starts, goals = view.setpoint.position.copy(), view.goals.copy()
        bounds = bounds_for(task, self._model, starts, goals)
        needed = float(shortest_time(np.abs(goals - starts), SPEED_LIMIT, ACCELERATION_LIMIT).max())
        clock = task.motion.stage_s or view.horizon_s
        duration = min(_LONGEST_S, max(clock - _SPARE_S, 1.25 * needed + 0.5))
        return plan_swarm(
            starts, goals, view.team, self._model, bounds, seed, max_duration=duration
        )


def bounds_for(
    task: Task, model: InteractionModel, starts: FloatArray, goals: FloatArray
) -> PlanningBounds:
    """Return bounds that leave room for tracking, as far as starts and goals (N, 3) allow."""
    margin = float(task.radius.max())
    room = [_room(points, task.radius) for points in (starts, goals)]
    low, high = task.arena[0] + margin, task.arena[1] - margin
    low = np.minimum(low, np.minimum(starts, goals).min(axis=0))
    high = np.maximum(high, np.maximum(starts, goals).max(axis=0))
    return PlanningBounds(
        lower=(float(low[0]), float(low[1]), float(low[2])),
        upper=(float(high[0]), float(high[1]), float(high[2])),
        speed=SPEED_LIMIT,
        acceleration=ACCELERATION_LIMIT,
        force_g=_force_bounds(task.team, model, starts, goals),
        clearance_factor=max(1.0, min(_CLEARANCE, *room)),
    )


def _room(points: FloatArray, radius: FloatArray) -> float:
    """Return the least ratio of two points' distance to the sum of their radii, less a rounding."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return float((apart / (radius[:, None] + radius[None])).min()) * (1.0 - 1e-9)


def _force_bounds(
    team: Team, model: InteractionModel, starts: FloatArray, goals: FloatArray
) -> dict[str, float]:
    """Return the paper's bounds, g, raised where hovering at starts and goals needs it."""
    bounds: dict[str, float] = {}
    for points in (starts, goals):
        together = np.abs(hover_force(model, points, team))
        for i, vehicle in enumerate(team):
            alone = abs(float(hover_force(model, points[[i]], [vehicle])[0]))
            needed = _HOVER_SHARE * max(float(together[i]), alone) / GRAM_FORCE
            least = FORCE_BOUNDS_G.get(vehicle.token, max(FORCE_BOUNDS_G.values()))
            bounds[vehicle.token] = max(bounds.get(vehicle.token, least), needed)
    return bounds
