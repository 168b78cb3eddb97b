"""Fig. 6 and 7 of Neural-Swarm2: swaps planned knowing the forces and not, and flown.

Fig. 6 shows one swap of three after stage 1, after stage 2, and unaware; Fig. 7 the worst errors
and forces of random swaps of two and three.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import default_engine, format_columns
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.plan_plot import PlanColumn, draw_columns
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.training.reproduce import planned_swaps as swaps
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, claims_of
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing.style import INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _trial_settings(options: Any) -> swaps.TrialSettings:
    truth = options.truth or "learned"
    return swaps.TrialSettings(load_belief(truth), truth, options.engine or default_engine())


def _grid_6(options: Any) -> Cells:
    """Plans of both planners with every seed, each kept in a file of its own."""
    settings, swap, folder = _trial_settings(options), swaps.figure_6_swap(), options.out / "plans"
    return {
        f"{p}, {s}": partial(
            swaps.kept_plan, folder / f"figure_6_{p}_{s}.npz", settings, swap, p, s
        )
        for s in range(options.seed, options.seed + options.trials)
        for p in swaps.PLANNERS
    }


def _report_6(options: Any, plans: Mapping[str, SwarmPlan]) -> Report:
    """The plans of the first seed, flown; of all seeds, who passes above whom."""
    settings, swap = _trial_settings(options), swaps.figure_6_swap()
    own = {planner: plans[f"{planner}, {options.seed}"] for planner in swaps.PLANNERS}
    cells = {p: swaps.fly_trial(settings, swap, plan, p, options.seed) for p, plan in own.items()}
    rows = [row for p in ("aware", "unaware") for row in _rows_6(p, cells[p], own[p])]
    passed: dict[str, Counter[str]] = {planner: Counter() for planner in swaps.PLANNERS}
    for name, plan in plans.items():
        passed[name.split(",")[0]][_passing_order(plan)] += 1
    orders = {planner: dict(found) for planner, found in passed.items()}
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
    tracks = {p: swaps.track_plan(q.trajectories, q.team, settings.model) for p, q in own.items()}
    draw = partial(_plot_6, plans=own, tracks=tracks)
    return Report(summary, _text_6(rows, orders), rows, {"figure_6.png": draw})


def _text_6(rows: list[dict[str, Any]], orders: Mapping[str, Mapping[str, int]]) -> str:
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


def _rows_6(planner: str, cell: Mapping[str, Any], plan: SwarmPlan) -> list[dict[str, Any]]:
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


def _plot_6(path: Path, plans: Mapping[str, SwarmPlan], tracks: Mapping[str, swaps.Track]) -> None:
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
_STATED_6 = (
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


def _claims_6(numbers: Any, extent: Extent) -> list[Claim]:
    """Forces of both plans against their bounds, and who passes above whom."""

    def worst(planner: str, tokens: str, what: str = "force_g") -> float:
        own = [r for r in numbers["rows"] if r["planner"] == planner and r["vehicle"] in tokens]
        return max(float(r[f"model_plant_{what}"]) for r in own)

    orders = numbers["orders"]["aware"]
    forces = (worst("aware", "S"), worst("aware", "L"), worst("unaware", "S"))
    errors = (worst("aware", "SL", "error_cm"), worst("unaware", "SL", "error_cm"))
    below = orders.get("L below S", 0) / sum(orders.values())
    ours = (*forces[:2], errors[0], forces[2], errors[1], below)
    return claims_of(_STATED_6, ours)


FIGURE_6 = Study(
    paper="neural-swarm2",
    name="figure-6",
    shows="a swap of two small robots and a large one, planned with and without the forces",
    takes=("truth", "engine", "trials"),
    check=swaps.check_planned,
    grid=_grid_6,
    report=_report_6,
    claims=_claims_6,
    quick={"trials": 2, "engine": "batch"},
)
"""Both planners with every seed."""


# In what plans are flown, and how the tables say it.
_PLANTS: Mapping[str, str] = {
    "model_plant": "(a) the planner's own model, tracked by a PID, no compensation",
    "plain": "(b) quadrotors in unknown air, no compensation",
    "compensated": "(b) quadrotors in unknown air, compensated",
}


def _settings(options: Any) -> dict[str, Any]:
    shared = _trial_settings(options)
    return {
        "seed": options.seed,
        "truth": shared.truth,
        "engine": shared.engine,
        "model": shared.model.fingerprint,
        "planned_share": swaps.PLANNED_SHARE,
        "attempts": swaps.ATTEMPTS,
    }


def _grid(options: Any) -> Cells:
    settings = _trial_settings(options)
    return {
        f"{team}, {planner}, {s}": partial(_trial, options.out, settings, team, planner, s)
        for team in options.scenarios
        for s in range(options.seed, options.seed + options.trials)
        for planner in swaps.PLANNERS
    }


def _trial(out: Path, settings: swaps.TrialSettings, team: str, planner: str, seed: int) -> Cell:
    """Plan, or read the plan that is kept, and fly."""
    swap, path = swaps.draw_swap(team, seed), out / "plans" / f"{team}_{planner}_{seed}.npz"
    plan = swaps.kept_plan(path, settings, swap, planner, seed)
    return swaps.fly_trial(settings, swap, plan, planner, seed)


def _report(options: Any, cells: Mapping[str, Cell]) -> Report:
    found = list(cells.values())
    rows = {plant: scenario_rows(found, plant) for plant in _PLANTS}
    summary = {
        **_settings(options),
        "trials": options.trials,
        "rows": rows,
        "not_converged": [n for n, c in cells.items() if c["plan"]["status"] != "converged"],
        "crashed": {s: [n for n, c in cells.items() if c[s]["crashed"]] for s in swaps.SIDES},
        "cells": found,
    }
    files = {
        f"figure_7{'' if plant == 'model_plant' else f'_{plant}'}.png": partial(
            plot_trials, cells=found, headline=f"Fig. 7 {title}", plant=plant
        )
        for plant, title in _PLANTS.items()
    }
    table = [{"plant": plant, **row} for plant in _PLANTS for row in rows[plant]]
    return Report(summary, _text(summary), table, files)


def scenario_rows(
    cells: Iterable[Mapping[str, Any]], plant: str = "model_plant"
) -> list[dict[str, Any]]:
    """One row for each scenario and planner of the cells, of what a plant has measured."""
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for cell in cells:
        grouped.setdefault((cell["scenario"], cell["planner"]), []).append(cell)
    return [_row(*key, own, plant) for key, own in grouped.items()]


def _row(
    scenario: str, planner: str, cells: Sequence[Mapping[str, Any]], plant: str
) -> dict[str, Any]:
    found = [cell[plant] for cell in cells]
    errors = [max(f["error_cm"]) for f in found]
    ratios = [f["over_bound"] for f in found]
    return {
        "scenario": scenario,
        "planner": planner,
        "trials": len(cells),
        "worst_error_cm": round(max(errors), 3),
        "median_error_cm": round(float(np.median(errors)), 3),
        **{
            f"worst_force_{token}_g": round(max(forces), 3) if forces else None
            for token in "SL"
            for forces in [_forces_on(scenario, token, found)]
        },
        "worst_over_bound": round(max(ratios), 3),
        "trials_over_bound": sum(ratio > 1.0 for ratio in ratios),
        "least_clearance": round(min(f["clearance"] for f in found), 3),
        "errors_cm": [round(error, 3) for error in errors],
        "over_bound": [round(ratio, 3) for ratio in ratios],
    }


def _forces_on(scenario: str, token: str, found: Sequence[Mapping[str, Any]]) -> list[float]:
    """Largest force on any vehicle of a type in each trial, g; empty where there is none."""
    own = [i for i, vehicle in enumerate(parse_team(scenario)) if vehicle.token == token]
    return [max(f["force_g"][i] for i in own) for f in found] if own else []


def format_scenarios(rows: Sequence[Mapping[str, Any]], title: str) -> str:
    """The rows of `scenario_rows` as text."""
    head = ("scenario", "planner", "error (cm)", "force S (g)", "force L (g)", "over bound")
    lines: list[tuple[str, ...]] = [(*head, "trials over")]
    for row in rows:
        columns = ("worst_error_cm", "worst_force_S_g", "worst_force_L_g", "worst_over_bound")
        values = ("-" if row[name] is None else f"{row[name]:.2f}" for name in columns)
        over = f"{row['trials_over_bound']} of {row['trials']}"
        lines.append((row["scenario"], row["planner"], *values, over))
    bounds = ", ".join(f"{FORCE_BOUNDS_G[token]:g} g ({token})" for token in "SL")
    return "\n".join([title, *format_columns(lines), f"worst of all trials; bounds {bounds}"])


def _text(summary: Mapping[str, Any]) -> str:
    """Tables of every plant, and which plans failed."""
    parts = [format_scenarios(summary["rows"][plant], title) for plant, title in _PLANTS.items()]
    crashed = [f"{n} ({side})" for side, names in summary["crashed"].items() for n in names]
    checks = [
        f"plans that did not converge: {'; '.join(summary['not_converged']) or 'none'}",
        f"crashed in (b): {'; '.join(crashed) or 'none'}",
    ]
    return "\n\n".join([*parts, "\n".join(checks)])


_LOOK = {"unaware": ("#D55E00", -0.17, "not knowing the forces (BL)"),
         "aware": ("#0072B2", 0.17, "knowing the forces (NN)")}  # fmt: skip
_SIZES = {"S": "small", "L": "large"}


def plot_trials(
    path: Path, cells: Sequence[Mapping[str, Any]], headline: str, plant: str = "model_plant"
) -> None:
    """Draw worst error and worst force of each trial; bars reach to the worst of all."""
    scenarios = list(dict.fromkeys(cell["scenario"] for cell in cells))
    with picture(path, 12.0, 4.6, headline) as figure:
        axes = figure.subplots(1, 3)
        for planner in _LOOK:
            own = [cell for cell in cells if cell["planner"] == planner]
            found = {s: [c[plant] for c in own if c["scenario"] == s] for s in scenarios}
            worst = {s: [max(f["error_cm"]) for f in trials] for s, trials in found.items()}
            _dots(axes[0], worst, planner)
            for axis, token in zip(axes[1:], "SL", strict=True):
                forces = {s: _forces_on(s, token, trials) for s, trials in found.items()}
                _dots(axis, {s: own for s, own in forces.items() if own}, planner)
        label_axis(axes[0], grid="y", title="Worst tracking error", ylabel="Error (cm)")
        for axis, token in zip(axes[1:], "SL", strict=True):
            bound = FORCE_BOUNDS_G[token]
            axis.axhline(bound, color="#C0202A", linewidth=1.4)
            title = f"Worst force on {_SIZES[token]} ones, bound {bound:g} g"
            label_axis(axis, grid="y", title=title, ylabel="|f_a,z| (g)")
        axes[0].margins(y=0.2)
        axes[0].legend(fontsize=9, loc="upper right")


def _dots(axis: Axes, values: Mapping[str, Sequence[float]], planner: str) -> None:
    color, offset, label = _LOOK[planner]
    place = np.arange(len(values)) + offset
    highest = [max(own) for own in values.values()]
    axis.bar(place, highest, 0.3, color=color, alpha=0.35, label=label)
    for x, own in zip(place, values.values(), strict=True):
        spread = x + np.linspace(-0.1, 0.1, len(own)) * (len(own) > 1)
        axis.plot(spread, own, "o", color=color, markersize=4, markeredgecolor="white",
                  markeredgewidth=0.4)  # fmt: skip
    axis.set_xticks(range(len(values)), list(values), color=INK)


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    rows = numbers["rows"]["model_plant"]
    unaware, aware = ([r for r in rows if r["planner"] == planner] for planner in swaps.PLANNERS)
    own = {row["scenario"]: row for row in unaware}
    drawn = Reason(
        "the swaps are sampled again; those of the paper are not published", Between(1.2, 3.0)
    )
    small = own["SL"]["worst_force_S_g"]
    teams = [team for team in ("SL", "SSL", "LL") if team in own]
    stated: list[tuple[Any, ...]] = [
        (f"{team}, unaware: worst force over its bound", "nearly double", Between(1.6, 2.4), drawn)
        for team in teams
    ]
    beyond = ("SL, unaware: worst force on the small robot, g", "greater than 10", Between(10.0))
    stated += [
        (*beyond, drawn) if small > 6.0 else beyond,
        ("unaware: worst tracking error of all scenarios, cm", "over 10", Between(10.0)),
        ("aware: worst force over its bound, all scenarios", "at most 1", Between(0.0, 1.0)),
        ("aware: worst tracking error of all scenarios, cm", "-", None),
    ]
    worst = {
        who: [max(row[name] for row in rows) for name in ("worst_error_cm", "worst_over_bound")]
        for who, rows in (("unaware", unaware), ("aware", aware))
    }
    errors = (worst["unaware"][0], worst["aware"][1], worst["aware"][0])
    return claims_of(stated, [*(own[team]["worst_over_bound"] for team in teams), small, *errors])


FIGURE_7 = Study(
    paper="neural-swarm2",
    name="figure-7",
    shows="worst errors and forces of random swaps, planned with and without the forces",
    takes=("truth", "engine", "scenarios", "trials"),
    check=swaps.check_planned,
    grid=_grid,
    settings=_settings,
    report=_report,
    claims=_claims,
    quick={"trials": 2, "engine": "batch", "scenarios": ("SL", "LL", "SSL")},
    note="On the planner's own model of the forces, tracked by a PID without compensation, as "
    "in the paper.",
)
"""Every trial of every team by both planners."""
