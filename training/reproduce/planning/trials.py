"""One trial of Fig. 7: a swap, planned with and without knowing the forces, and flown.

Both planners have identical parameters; they differ in the model alone, which is none for the one
that does not know. Their plans are flown (a) as published, on the planner's own model of the robots
and the forces, tracked by a PID; (b) by quadrotors, in air that the planner does not know.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.pipeline import plan_swarm
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G, PlanningBounds
from swarm_envs.control.config import ControllerConfig
from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.planning.flight import fly_plan
from swarm_envs.training.reproduce.planning.plant import Track, track_plan
from swarm_envs.training.reproduce.planning.scenarios import Swap
from swarm_envs.training.reproduce.runs import Cell
from swarm_envs.vehicles import GRAM_FORCE, Team, parse_team

PLANNERS = ("unaware", "aware")
"""Who plans: without the forces, the paper's BL, and with them, its NN."""


SIDES = ("plain", "compensated")
"""Who flies the plan in the unknown air: the tracking controller without belief, and with."""

PLANNED_SHARE = 0.9
"""Share of the force bounds that plans may use; the rest is left to tracking errors, and to what
blows between knots. The same for both planners."""
ATTEMPTS = 6
"""How often either planner may begin anew while its plan breaks a bound."""


def planning_bounds() -> PlanningBounds:
    """What every plan shall keep to, whoever makes it."""
    return PlanningBounds(force_g={t: PLANNED_SHARE * b for t, b in FORCE_BOUNDS_G.items()})


@dataclass(frozen=True)
class TrialSettings:
    """What all trials share."""

    model: InteractionModel
    """What the aware planner knows and the compensating controller believes; the plant of (a)."""
    truth: str | InteractionModel = "learned"
    """The force that blows in (b)."""
    engine: str = "batch"
    """Of (b): `bullet` or `batch`."""
    bounds: PlanningBounds = field(default_factory=planning_bounds)
    """What every plan shall keep to, whoever makes it."""

    def plan(self, swap: Swap, planner: str, seed: int) -> SwarmPlan:
        """Plan a swap in the y-z plane, with everything equal but the model.

        Raises:
            ValueError: no plan can exist, or there is no such planner.
        """
        check_name("planner", planner, PLANNERS)
        model = self.model if planner == "aware" else None
        return plan_swarm(
            swap.starts,
            swap.goals,
            swap.team,
            model,
            self.bounds,
            seed,
            plane="yz",
            attempts=ATTEMPTS,
        )


def kept_plan(
    path: Path, settings: TrialSettings, swap: Swap, planner: str, seed: int
) -> SwarmPlan:
    """The plan that the file keeps, or one that is made now and kept there.

    Raises:
        ValueError: the file keeps a plan of another swap, model, seed or bounds.
    """
    if not path.is_file():
        plan = settings.plan(swap, planner, seed)
        plan.save(path)
        return plan
    plan = SwarmPlan.load(path)
    model = settings.model if planner == "aware" else load("none")
    same = (
        plan.team == parse_team(swap.team)
        and np.array_equal(plan.starts, swap.starts)
        and np.array_equal(plan.goals, swap.goals)
        and (plan.seed, plan.bounds) == (seed, settings.bounds)
        and plan.model_fingerprint == model.fingerprint
    )
    if not same:
        raise ValueError(
            f"{str(path)!r} keeps a plan of another swap, model, seed or bounds; choose another "
            "folder by --out, or delete it"
        )
    return plan


def fly_trial(
    settings: TrialSettings, swap: Swap, plan: SwarmPlan, planner: str, seed: int
) -> Cell:
    """Track a plan on the planner's own model, and fly it in the unknown air.

    Args:
        settings: what all trials share.
        swap: who goes where.
        plan: for this swap.
        planner: who made it.
        seed: of the trial.
    """
    track = track_plan(plan.trajectories, plan.team, settings.model)
    cell: Cell = {
        "scenario": swap.team,
        "planner": planner,
        "seed": seed,
        "plan": {
            "status": plan.status,
            "reason": plan.reason,
            "duration_s": round(plan.duration, 6),
            "energy": round(plan.trajectories.energy, 6),
            "predicted_force_ratio": round(plan.check.force_ratio, 4),
            "seconds": round(sum(plan.seconds.values()), 1),
        },
        "model_plant": measure(track, plan.team),
    }
    for side in SIDES:
        believed = settings.model if side == "compensated" else None
        controller = ControllerConfig(feedforward=believed)
        flown, crashed = fly_plan(plan, controller, settings.truth, settings.engine)
        cell[side] = {**measure(flown, plan.team), "crashed": crashed}
    return cell


def measure(track: Track, team: Team) -> dict[str, Any]:
    """What Fig. 7 shows of one tracked plan, and how near robots came.

    Returns:
        `error_cm`, worst tracking error of each robot; `force_g`, largest |f_a,z| on each;
        `over_bound`, the largest over all robots relative to its bound; `clearance`, the smallest
        distance between two robots over the sum of their radii.
    """
    force = np.abs(track.force[..., 2]).max(axis=0) / GRAM_FORCE
    bound = np.array([FORCE_BOUNDS_G[vehicle.token] for vehicle in team])
    return {
        "error_cm": np.round(100.0 * track.error.max(axis=0), 4).tolist(),
        "force_g": np.round(force, 4).tolist(),
        "over_bound": round(float((force / bound).max()), 4),
        "clearance": round(clearance(track.position, team), 4),
    }


def clearance(position: FloatArray, team: Team) -> float:
    """Smallest distance of two robots over the sum of their radii, over positions (K, N, 3), m."""
    radius = np.array([vehicle.radius for vehicle in team])
    first, second = np.triu_indices(len(team), 1)
    apart = np.linalg.norm(position[:, first] - position[:, second], axis=-1)
    return float((apart / (radius[first] + radius[second])).min())
