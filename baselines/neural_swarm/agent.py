"""The agents of Neural-Swarm2: the tracking controller (Sec. VI) and the planner (Sec. V).

Both emit set-points; the tracking loop that follows them is the environment's, configured as the
agent declares. `TrackingAgent` emits those of the task's reference; `PlanAgent` plans when goals
are set, and emits those of its plan. What they compensate is the force that a deep set predicts,
fitted to flights inside the environment, never the environment's own model; without it the
controller is the paper's baseline, identical in everything else.
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
"""Files of the shipped deep sets, by the force model of the environment they were fitted in."""
MAX_DRONES = 6
"""More drones than this are refused: planning one after another gets slow and finds no way."""
_LONGEST_S = 6.0  # of a plan: more time makes it cheaper, but not by much
_SPARE_S = 1.5  # of the clock: what is left for settling at the goals
_CLEARANCE = 1.6  # over the sum of radii where starts and goals allow it: below 1.5 is a near miss
_HOVER_SHARE = 1.2  # force bound over the force when hovering, where that is above the paper's


def load_belief(truth: str = "learned") -> InteractionModel:
    """The deep set of the compensated controller and the planner: fitted to simulated flights.

    See `weights/MODEL_CARD.md` for the flights and the errors.

    Args:
        truth: name of the environment's force model in whose flights it was fitted.

    Raises:
        ValueError: no deep set ships for that model.
    """
    if truth not in BELIEFS:
        raise ValueError(
            f"no belief ships for an environment with the force model {truth!r}, only for "
            f"{' and '.join(BELIEFS)}; fit one to flights there, by `python -m "
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
        controller: configuration of the loop; None for the paper's baseline, uncompensated.
        decision_rate: set-points per second.
    """

    def __init__(self, controller: ControllerConfig | None = None, decision_rate: int = 48) -> None:
        check_type("controller", controller, ControllerConfig | None)
        check_integer("decision_rate", decision_rate)
        given = controller or ControllerConfig()
        super().__init__(
            {"action": "setpoint", "decision_rate": decision_rate, "controller": given}
        )

    @classmethod
    def compensated(
        cls, belief: InteractionModel | None = None, decision_rate: int = 48
    ) -> TrackingAgent:
        """The agent that feeds forward the force of a model; by default `load_belief()`."""
        return cls(ControllerConfig(feedforward=belief or load_belief()), decision_rate)

    @classmethod
    def adaptive(cls) -> TrackingAgent:
        """The agent that estimates the force in flight, by `Indi`, and knows no model."""
        return cls(ControllerConfig(adaptation=Indi()))

    @classmethod
    def compensated_adaptive(cls, belief: InteractionModel | None = None) -> TrackingAgent:
        """The agent that feeds a model's force forward, and estimates what that leaves over."""
        return cls(ControllerConfig(feedforward=belief or load_belief(), adaptation=Indi()))

    def reference(self, view: View) -> Reference:
        """The task's reference at this time."""
        return view.reference(view.time)


def compensated_detour(belief: InteractionModel | None = None) -> DetourAgent:
    """`DetourAgent` over the paper's controller, which feeds `load_belief()` or another forward."""
    return DetourAgent(ControllerConfig(feedforward=belief or load_belief()))


class PlanAgent(PlannedAgent[SwarmPlan]):
    """Plans at every change of goals, with its own model of the forces, and flies the plan.

    Args:
        belief: force model of planner and controller; None for `load_belief()`.
        decision_rate: set-points per second.
    """

    def __init__(self, belief: InteractionModel | None = None, decision_rate: int = 48) -> None:
        check_integer("decision_rate", decision_rate)
        self._model = belief or load_belief()
        tracking = TrackingAgent.compensated(self._model, decision_rate)
        super().__init__(tracking.requires)

    def check(self, task: Task) -> None:
        """Refuse a task to which there is no plan."""
        super().check(task)
        if len(task.team) > MAX_DRONES:
            raise ValueError(
                f"PlanAgent got {len(task.team)} drones, but plans for at most {MAX_DRONES}; for "
                "more use an agent that does not plan all together, such as 'tracking+compensated'"
            )
        if task.obstacles:
            raise ValueError(
                f"PlanAgent knows no obstacles, but there are {len(task.obstacles)}; make the "
                "environment without"
            )

    def plan(self, task: Task, view: View, seed: int) -> SwarmPlan:
        """A plan that keeps the predicted forces within bounds; look if it converged."""
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
    """Bounds that leave room for tracking, as far as starts and goals (N, 3) allow."""
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
    """Smallest distance of two points (N, 3) over the sum of their radii, less a rounding."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return float((apart / (radius[:, None] + radius[None])).min()) * (1.0 - 1e-9)


def _force_bounds(
    team: Team, model: InteractionModel, starts: FloatArray, goals: FloatArray
) -> dict[str, float]:
    """The paper's bounds, g, or more where hovering at starts and goals needs it."""
    bounds: dict[str, float] = {}
    for points in (starts, goals):
        together = np.abs(hover_force(model, points, team))
        for i, vehicle in enumerate(team):
            alone = abs(float(hover_force(model, points[[i]], [vehicle])[0]))
            needed = _HOVER_SHARE * max(float(together[i]), alone) / GRAM_FORCE
            least = FORCE_BOUNDS_G.get(vehicle.token, max(FORCE_BOUNDS_G.values()))
            bounds[vehicle.token] = max(bounds.get(vehicle.token, least), needed)
    return bounds
