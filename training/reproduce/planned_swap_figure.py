"""Fig. 6 of Neural-Swarm2: a three-robot swap after stage 1, after stage 2, and unaware."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import default_engine, format_columns
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason
from swarm_envs.training.reproduce.planned_swaps import (
    PLANNERS,
    Track,
    TrialSettings,
    check_planned,
    figure_6_swap,
    fly_trial,
    kept_plan,
    plan_at,
    track_plan,
)
from swarm_envs.training.reproduce.study import Cells, Report, Study
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.style import picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#0072B2", "#E69F00", "#009E73")  # of the small robots and the large one, as the paper's
_FINE_S = 1.0 / 60.0


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
    """Stage 1, stage 2 as planned and tracked, and the plan that does not know the forces."""
    aware, unaware = plans["aware"], plans["unaware"]
    headline = "Fig. 6: two small robots and a large one exchange positions"
    with picture(path, 13.0, 6.0, headline) as figure:
        above, below = figure.subplots(2, 3, sharex="row", sharey="row")
        columns = (
            ("Stage 1, knowing the forces", aware, aware.initial, None),
            ("Stage 2, knowing the forces", aware, aware.trajectories, tracks["aware"]),
            ("Not knowing the forces", unaware, unaware.trajectories, tracks["unaware"]),
        )
        for k, (title, plan, motions, track) in enumerate(columns):
            _paths(above[k], plan, motions, track)
            _forces(below[k], plan, motions, track)
            above[k].set(title=title, xlabel="y (m)", xticks=(-1.0, -0.5, 0.0, 0.5, 1.0))
            below[k].set_xlabel("Time (s)")
        above[0].set_ylabel("z (m)")
        below[0].set_ylabel("f_a,z (g)")
        below[0].legend(fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.supxlabel(
            "Dashed: planned, or the bounds of the forces. Solid: tracked by a PID in the air that "
            "the model knows. Discs: the robots half way. Arrows: velocity every second.",
            fontsize=9,
        )


def _paths(axis: Axes, plan: SwarmPlan, motions: Trajectories, track: Track | None) -> None:
    times = np.arange(0.0, motions.duration, _FINE_S)
    planned, _, _ = plan_at(motions, times)
    when, flown = (times, planned) if track is None else (track.time, track.position)
    speed = plan_at(motions, times)[1] if track is None else track.velocity
    for i, vehicle in enumerate(plan.team):
        color = _COLORS[i % len(_COLORS)]
        if track is not None:
            axis.plot(planned[:, i, 1], planned[:, i, 2], "--", color=color, linewidth=1.0)
        axis.plot(flown[:, i, 1], flown[:, i, 2], color=color, linewidth=1.7, label=vehicle.token)
        seconds = np.searchsorted(when, np.arange(1.0, motions.duration))
        axis.quiver(flown[seconds, i, 1], flown[seconds, i, 2], speed[seconds, i, 1],
                    speed[seconds, i, 2], color=color, angles="xy", scale_units="xy", scale=4.0,
                    width=0.006, zorder=4)  # fmt: skip
        _body(axis, flown[np.searchsorted(when, 0.5 * motions.duration), i], vehicle.radius, color)
        axis.plot(*plan.starts[i, 1:], "o", color=color, markersize=4)
        axis.plot(*plan.goals[i, 1:], "s", color=color, markersize=5, markerfacecolor="white")
    axis.set_aspect("equal")
    label_axis(axis)


def _body(axis: Axes, place: FloatArray, radius: float, color: str) -> None:
    from matplotlib.patches import Circle

    circle = Circle((float(place[1]), float(place[2])), radius, facecolor=color, alpha=0.35)
    axis.add_patch(circle)


def _forces(axis: Axes, plan: SwarmPlan, motions: Trajectories, track: Track | None) -> None:
    time = motions.times if track is None else track.time
    force = motions.forces if track is None else track.force
    for i, vehicle in enumerate(plan.team):
        color, bound = _COLORS[i % len(_COLORS)], FORCE_BOUNDS_G[vehicle.token]
        name = "small" if vehicle.token == "S" else "large"
        axis.plot(time, force[:, i, 2] / GRAM_FORCE, color=color, label=name)
        for side in (-1.0, 1.0):
            axis.axhline(side * bound, color=color, linestyle="--", linewidth=0.9)
    label_axis(axis, zero=True)


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Forces of both plans against their bounds, and who passes above whom."""

    def worst(planner: str, tokens: str, what: str = "force_g") -> float:
        own = [r for r in numbers["rows"] if r["planner"] == planner and r["vehicle"] in tokens]
        return max(float(r[f"model_plant_{what}"]) for r in own)

    orders = numbers["orders"]["aware"]
    optimum = Reason(
        "a plan is a local optimum: some seeds pass a small robot 0.6 m beneath, at much the same "
        "cost",
        Between(0.0, 0.5),
    )
    shorter = Reason("our starts and goals are not theirs, which are not published", Between(1.0))
    return [
        Claim(
            "aware plan: force on a small robot, g",
            "very small, bound 5",
            worst("aware", "S"),
            Between(0.0, 5.0),
        ),
        Claim(
            "aware plan: force on the large robot, g",
            "within the bound of 10",
            worst("aware", "L"),
            Between(0.0, 10.0),
        ),
        Claim(
            "aware plan: worst tracking error, cm",
            "not significant",
            worst("aware", "SL", "error_cm"),
            Between(0.0, 2.0),
        ),
        Claim(
            "unaware plan: force on a small robot, g",
            "beyond the bound of 5",
            worst("unaware", "S"),
            Between(5.0),
        ),
        Claim(
            "unaware plan: worst tracking error, cm",
            "significant",
            worst("unaware", "SL", "error_cm"),
            Between(5.0),
            (shorter,),
        ),
        Claim(
            "share of aware plans that send the large robot below",
            "1 of 1",
            orders.get("L below S", 0) / sum(orders.values()),
            Between(0.51, 1.0),
            (optimum,),
        ),
    ]


FIGURE_6 = Study(
    paper="neural-swarm2",
    name="figure-6",
    label="Fig. 6",
    shows="a swap of two small robots and a large one, planned with and without the forces",
    takes=("truth", "engine", "trials"),
    check=check_planned,
    grid=_grid,
    report=_report,
    claims=_claims,
    pictures=("figure_6.png",),
    quick={"trials": 2, "engine": "batch"},
)
"""Both planners with every seed."""
