"""One trial of Fig. 7: a swap, planned with and without knowing the forces, and tracked.

Both planners have identical parameters; they differ in the model alone, which is none for the one
that does not know. Tracked are both in air that blows as the model says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.bounds import FORCE_BOUNDS_G
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.planning.plant import Track, track_plan
from swarm_envs.training.reproduce.planning.scenarios import Swap
from swarm_envs.training.reproduce.runs import Cell
from swarm_envs.vehicles import GRAM_FORCE, Team, parse_team

PLANNERS = ("unaware", "aware")
"""Who plans: without the forces, the paper's BL, and with them, its NN."""


class Planned(NamedTuple):
    """What a planner returns to a trial."""

    plan: Trajectories
    """What the robots shall fly."""
    about: Mapping[str, Any]
    """What is told of it, ready for JSON: cost, convergence."""


Planner = Callable[[Swap, str, int], Planned]
"""Plans a swap, `aware` or `unaware`, with a seed."""


def fly_trial(swap: Swap, planner: str, seed: int, plan: Planner, model: InteractionModel) -> Cell:
    """Plan a swap and track the plan on the planner's own model.

    Args:
        swap: who goes where.
        planner: one of `PLANNERS`.
        seed: of the planner.
        plan: what plans.
        model: what blows, and what the aware planner knows.
    """
    planned = plan(swap, planner, seed)
    team = parse_team(swap.team)
    track = track_plan(planned.plan, team, model)
    return {
        "scenario": swap.team,
        "planner": planner,
        "seed": seed,
        "plan": {
            **planned.about,
            "duration_s": round(planned.plan.duration, 6),
            "energy": round(planned.plan.energy, 6),
        },
        "model_plant": measure(track, team),
    }


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
