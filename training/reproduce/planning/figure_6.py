"""Fig. 6: the three-robot swap after stage 1, after stage 2, and planned without the forces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.files import write_json, write_table
from swarm_envs.training.reproduce.planning.figure_6_plot import plot_figure_6
from swarm_envs.training.reproduce.planning.plant import track_plan
from swarm_envs.training.reproduce.planning.scenarios import TRIALS, figure_6_swap
from swarm_envs.training.reproduce.planning.trials import (
    PLANNERS,
    TrialSettings,
    fly_trial,
    kept_plan,
)
from swarm_envs.training.reproduce.runs import draw_seeds
from swarm_envs.vehicles import GRAM_FORCE


def reproduce_figure_6(
    out: Path,
    seed: int = 0,
    trials: int = TRIALS,
    truth: str = "learned",
    engine: str = "batch",
    progress: bool = True,
) -> dict[str, Any]:
    """Plan the swap of two small robots and a large one both ways; write `figure_6.*`.

    Args:
        out: folder, made if missing; the plans are kept in its folder `plans`.
        seed: of the planners whose plans are flown and drawn.
        trials: seeds from it on with which both plan: who passes above whom is counted.
        truth: the force that blows where quadrotors fly the plans.
        engine: who computes these flights.
        progress: show a progress bar.

    Returns:
        The numbers, ready for JSON.

    Raises:
        ValueError: no belief ships for that truth, or the folder keeps other plans.
    """
    settings, swap = TrialSettings(load_belief(truth), truth, engine), figure_6_swap()
    seeds = range(seed, seed + len(draw_seeds(seed, trials)))
    jobs = [(planner, s) for s in seeds for planner in PLANNERS]
    made = {}
    for planner, s in tqdm(jobs, desc="figure_6", unit="plan", disable=not progress):
        path = out / "plans" / f"figure_6_{planner}_{s}.npz"
        made[planner, s] = kept_plan(path, settings, swap, planner, s)
    plans = {planner: made[planner, seed] for planner in PLANNERS}
    cells = {p: fly_trial(settings, swap, plan, p, seed) for p, plan in plans.items()}
    rows = [row for p in ("aware", "unaware") for row in _rows(p, cells[p], plans[p])]
    summary = {
        "seed": seed,
        "team": swap.team,
        "truth": truth,
        "engine": engine,
        "model": settings.model.fingerprint,
        "starts_m": swap.starts.tolist(),
        "goals_m": swap.goals.tolist(),
        "rows": rows,
        "cost": {p: plan.costs for p, plan in plans.items()},
        "orders": {p: dict(Counter(order(made[p, s]) for s in seeds)) for p in PLANNERS},
        "trials": cells,
    }
    write_json(out / "figure_6.json", summary)
    write_table(out / "figure_6.csv", rows)
    tracks = {p: track_plan(q.trajectories, q.team, settings.model) for p, q in plans.items()}
    plot_figure_6(out / "figure_6.png", plans, tracks)
    return summary


def _rows(planner: str, cell: Mapping[str, Any], plan: SwarmPlan) -> list[dict[str, Any]]:
    """One row for each robot: worst error and force, on the model and flown by quadrotors."""
    predicted = np.abs(plan.forces[..., 2]).max(axis=0) / GRAM_FORCE
    return [
        {
            "planner": planner,
            "robot": i,
            "vehicle": vehicle.token,
            "bound_g": FORCE_BOUNDS_G[vehicle.token],
            "planned_at_knots_g": round(float(predicted[i]), 3),
            **{
                f"{plant}_{what}": round(cell[plant][what][i], 3)
                for plant in ("model_plant", "plain", "compensated")
                for what in ("force_g", "error_cm")
            },
        }
        for i, vehicle in enumerate(plan.team)
    ]


def order(plan: SwarmPlan) -> str:
    """Vehicles from the lowest up where the large robot and its nearest neighbour in y pass."""
    large = [vehicle.token for vehicle in plan.team].index("L")
    apart = np.abs(plan.trajectories.position[:, :, 1] - plan.trajectories.position[:, [large], 1])
    apart[:, large] = np.inf
    knot = int(apart.min(axis=1).argmin())
    near = [large, int(apart[knot].argmin())]
    heights = plan.trajectories.position[knot, near, 2]
    return " below ".join(plan.team[near[k]].token for k in np.argsort(heights))


def format_figure_6(summary: Mapping[str, Any]) -> str:
    """Worst force and error of each robot, as text."""
    lines = [
        "Worst force (g) and tracking error (cm): PID on the planner's model | quadrotors in "
        "unknown air, compensated",
        f"{'planner':10}{'robot':8}{'bound':>7}{'at knots':>9}{'force':>8}{'error':>8}  |"
        f"{'force':>8}{'error':>8}",
    ]
    for r in summary["rows"]:
        lines.append(
            f"{r['planner']:10}{r['robot']} ({r['vehicle']})  {r['bound_g']:7g}"
            f"{r['planned_at_knots_g']:9.2f}{r['model_plant_force_g']:8.2f}"
            f"{r['model_plant_error_cm']:8.2f}  |{r['compensated_force_g']:8.2f}"
            f"{r['compensated_error_cm']:8.2f}"
        )
    for planner, found in summary["orders"].items():
        counts = ", ".join(f"{what} in {number}" for what, number in sorted(found.items()))
        lines.append(f"where the large one and its nearest pass, {planner}: {counts} plans")
    return "\n".join(lines)
