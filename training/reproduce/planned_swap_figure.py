"""Fig. 6 of Neural-Swarm2: a three-robot swap after stage 1, after stage 2, and unaware."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import default_engine, format_columns
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.plan_plot import PlanColumn, draw_columns
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, claims_of
from swarm_envs.training.reproduce.planned_swaps import (
    PLANNERS,
    Track,
    TrialSettings,
    check_planned,
    figure_6_swap,
    fly_trial,
    kept_plan,
    track_plan,
)
from swarm_envs.training.reproduce.study import Cells, Report, Study
from swarm_envs.vehicles import GRAM_FORCE


def _settings(options: Any) -> TrialSettings:
    truth = options.truth or "learned"
    return TrialSettings(load_belief(truth), truth, options.engine or default_engine())


def _grid(options: Any) -> Cells:
    """Plans of both planners with every seed, each kept in a file of its own."""
    settings, swap, folder = _settings(options), figure_6_swap(), options.out / "plans"
    return {
        f"{p}, {s}": partial(kept_plan, folder / f"figure_6_{p}_{s}.npz", settings, swap, p, s)
        for s in range(options.seed, options.seed + options.trials)
        for p in PLANNERS
    }


def _report(options: Any, plans: Mapping[str, SwarmPlan]) -> Report:
    """The plans of the first seed, flown; of all seeds, who passes above whom."""
    settings, swap = _settings(options), figure_6_swap()
    own = {planner: plans[f"{planner}, {options.seed}"] for planner in PLANNERS}
    cells = {p: fly_trial(settings, swap, plan, p, options.seed) for p, plan in own.items()}
    rows = [row for p in ("aware", "unaware") for row in _rows(p, cells[p], own[p])]
    orders = {
        p: dict(
            Counter(_passing_order(plan) for name, plan in plans.items() if name.split(",")[0] == p)
        )
        for p in PLANNERS
    }
    summary = {
        "seed": options.seed,
        "team": swap.team,
        "truth": settings.truth,
        "engine": settings.engine,
        "model": settings.model.fingerprint,
        "starts_m": swap.starts.tolist(),
        "goals_m": swap.goals.tolist(),
        "rows": rows,
        "cost": {p: plan.costs for p, plan in own.items()},
        "orders": orders,
        "trials": cells,
    }
    tracks = {p: track_plan(q.trajectories, q.team, settings.model) for p, q in own.items()}
    draw = partial(_plot, plans=own, tracks=tracks)
    return Report(summary, _text(rows, orders), rows, {"figure_6.png": draw})


def _text(rows: list[dict[str, Any]], orders: Mapping[str, Mapping[str, int]]) -> str:
    """Worst force and error of each robot, and how the plans pass."""
    columns = ("model_plant_force_g", "model_plant_error_cm", "compensated_force_g",
               "compensated_error_cm")  # fmt: skip
    lines = [("planner", "robot", "bound", "at knots", "force", "error", "| force", "error")]
    for row in rows:
        values = (f"{row[name]:.2f}" for name in ("planned_at_knots_g", *columns))
        robot = f"{row['robot']} ({row['vehicle']})"
        lines.append((row["planner"], robot, f"{row['bound_g']:g}", *values))
    said = [
        "Worst force (g) and tracking error (cm): PID on the planner's model | quadrotors in "
        "unknown air, compensated",
        *format_columns(lines),
    ]
    for planner, found in orders.items():
        counts = ", ".join(f"{what} in {number}" for what, number in sorted(found.items()))
        said.append(f"where the large one and its nearest pass, {planner}: {counts} plans")
    return "\n".join(said)


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


def _passing_order(plan: SwarmPlan) -> str:
    """Vehicles from the lowest up where the large robot and its nearest neighbour in y pass."""
    large = [vehicle.token for vehicle in plan.team].index("L")
    apart = np.abs(plan.trajectories.position[:, :, 1] - plan.trajectories.position[:, [large], 1])
    apart[:, large] = np.inf
    knot = int(apart.min(axis=1).argmin())
    near = [large, int(apart[knot].argmin())]
    heights = plan.trajectories.position[knot, near, 2]
    return " below ".join(plan.team[near[k]].token for k in np.argsort(heights))


def _plot(path: Path, plans: Mapping[str, SwarmPlan], tracks: Mapping[str, Track]) -> None:
    """Stage 1, stage 2 as tracked, and the plan that does not know the forces, as tracked."""
    first = plans["aware"].initial
    titles = {"aware": "Stage 2, knowing the forces", "unaware": "Not knowing the forces"}
    columns = [
        PlanColumn("Stage 1, knowing the forces", first.times, first.position, first.forces),
        *(PlanColumn(titles[p], t.time, t.position, t.force) for p, t in sorted(tracks.items())),
    ]
    headline = "Fig. 6: a swap, tracked by a PID in the air that the model knows"
    draw_columns(path, plans["aware"], columns, headline)


_LOCAL = (
    "a plan is a local optimum: some seeds pass a small robot 0.6 m beneath, at much the same cost"
)
_OTHER_SWAP = "our starts and goals are not theirs, which are not published"
_STATED = (
    ("aware plan: force on a small robot, g", "very small, bound 5", Between(0.0, 5.0)),
    ("aware plan: force on the large robot, g", "within the bound of 10", Between(0.0, 10.0)),
    ("aware plan: worst tracking error, cm", "not significant", Between(0.0, 2.0)),
    ("unaware plan: force on a small robot, g", "beyond the bound of 5", Between(5.0)),
    (
        *("unaware plan: worst tracking error, cm", "significant", Between(5.0)),
        Reason(_OTHER_SWAP, Between(1.0)),
    ),
    (
        *("share of aware plans that send the large robot below", "1 of 1", Between(0.51, 1.0)),
        Reason(_LOCAL, Between(0.0, 0.5)),
    ),
)


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Forces of both plans against their bounds, and who passes above whom."""

    def worst(planner: str, tokens: str, what: str = "force_g") -> float:
        own = [r for r in numbers["rows"] if r["planner"] == planner and r["vehicle"] in tokens]
        return max(float(r[f"model_plant_{what}"]) for r in own)

    orders = numbers["orders"]["aware"]
    forces = (worst("aware", "S"), worst("aware", "L"), worst("unaware", "S"))
    errors = (worst("aware", "SL", "error_cm"), worst("unaware", "SL", "error_cm"))
    below = orders.get("L below S", 0) / sum(orders.values())
    ours = (*forces[:2], errors[0], forces[2], errors[1], below)
    return claims_of(_STATED, ours)


FIGURE_6 = Study(
    paper="neural-swarm2",
    name="figure-6",
    shows="a swap of two small robots and a large one, planned with and without the forces",
    takes=("truth", "engine", "trials"),
    check=check_planned,
    grid=_grid,
    report=_report,
    claims=_claims,
    quick={"trials": 2, "engine": "batch"},
)
"""Both planners with every seed."""
