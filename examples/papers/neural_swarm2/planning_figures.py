"""Fig. 6 and 7: swaps planned with and without a force model, and simulated.

Fig. 6 shows one swap of three drones after stage 1, after stage 2, and planned without forces; Fig.
7 the worst errors and forces of random swaps of two and three drones.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from examples.papers.common import Row, markdown, write_compared
from examples.papers.neural_swarm2.plan_pictures import PlanColumn, draw_columns
from examples.papers.neural_swarm2.planned_swaps import (
    PLANNERS,
    SIDES,
    draw_swap,
    figure_6_swap,
    fly_trial,
    plan_swap,
    track_plan,
)
from swarm_envs.baselines.neural_swarm import SwarmPlan, load_belief
from swarm_envs.baselines.neural_swarm.flights import default_engine
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.interactions import InteractionModel
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from swarm_envs.viewing.style import INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCENARIOS = ("SS", "SL", "LL", "SSS", "SSL", "SLL", "LLL")
"""Teams of two and three. The paper's text names SL, LL and SSL; its picture is not extracted."""
PLANTS: Mapping[str, str] = {
    "model_plant": "(a) the planner's own model, tracked by a PID, no compensation",
    "plain": "(b) quadrotors in unknown air, no compensation",
    "compensated": "(b) quadrotors in unknown air, compensated",
}
"""Plants in which plans are flown, and their titles."""
COLUMNS = (
    *("scenario", "planner", "worst_error_cm", "worst_force_S_g", "worst_force_L_g"),
    *("worst_over_bound", "trials_over_bound", "trials"),
)
ORDERS = (*PLANNERS, "published")  # aware by plain AO-RRT, of which only the order is counted
LOOKS = {
    "unaware": ("#D55E00", -0.17, "not knowing the forces (BL)"),
    "aware": ("#0072B2", 0.17, "knowing the forces (NN)"),
}
"""Color, offset and label of each planner."""
LOCAL = (
    "a plan is a local optimum, and both orders cost much the same: the forces do not decide who "
    "passes below, so the point of the paper's figure is not reproduced"
)
BOUNDED = "the plan keeps its bound and no more: a smaller force would cost a longer way"
ABOVE, BELOW = ("0 of 1", (0.0, 0.2)), ("1 of 1", (0.8, 1.0))
BELOW_SHARE = {"unaware": ABOVE, "aware": BELOW, "published": BELOW}
"""The paper's share of plans that send the large robot below, and the accepted range."""
OTHER_SWAP = "our starts and goals are not theirs, which are not published"
SAMPLED = "the swaps are sampled again; those of the paper are not published"


# ---- Fig. 6


def figure_6(
    out: Path = Path("neural_swarm2"),
    truth: str = "learned",
    engine: str = default_engine(),
    trials: int = 5,
    seed: int = 0,
) -> None:
    """Plan a swap of two small robots and a large one with and without the forces (Fig. 6).

    Writes `figure_6.json` (`rows`: forces and errors of each robot; `orders`: which robot passes
    below, by planner; `trials`) and `figure_6.png`.

    Args:
        out: folder, made if missing.
        truth: force model of the environment, `learned` or `wake`; the planner knows a fitted one.
        engine: of the flights, `bullet` or `batch`.
        trials: seeds with which the swap is planned; the plan of the first is flown and drawn.
        seed: the first of them.
    """
    model, swap = load_belief(truth), figure_6_swap()
    pairs = [(s, planner) for s in range(seed, seed + trials) for planner in ORDERS]
    plans = {(s, p): plan_swap(swap, model, p, s) for s, p in tqdm(pairs, "Fig. 6", unit="plan")}
    own = {planner: plans[seed, planner] for planner in PLANNERS}
    flown = {p: fly_trial(swap, q, p, seed, model, truth, engine) for p, q in own.items()}
    rows = [row for p in ("aware", "unaware") for row in robot_rows(p, flown[p], own[p])]
    orders = {
        planner: dict(Counter(passing_order(q) for (_, p), q in plans.items() if p == planner))
        for planner in ORDERS
    }
    summary = {
        "seed": seed,
        "team": swap.team,
        "truth": truth,
        "engine": engine,
        "model": model.fingerprint,
        "starts_m": swap.starts.tolist(),
        "goals_m": swap.goals.tolist(),
        "rows": rows,
        "cost": {p: plan.costs for p, plan in own.items()},
        "orders": orders,
        "trials": flown,
    }
    write_compared(out / "figure_6.json", summary, compare_6(rows, orders))
    plot_figure_6(out / "figure_6.png", own, model)
    print("Worst force and tracking error, on the planner's model and flown by quadrotors")
    print(markdown(rows, list(rows[0])))
    for planner, found in orders.items():
        print(f"where the large one and its nearest pass, {planner}: {found}")


def robot_rows(planner: str, trial: Mapping[str, Any], plan: SwarmPlan) -> list[dict[str, Any]]:
    """Return a row for each robot: worst error and force, on the model and flown by quadrotors."""
    predicted = np.abs(plan.trajectories.forces[..., 2]).max(axis=0) / GRAM_FORCE
    return [
        {
            "planner": planner,
            "robot": i,
            "vehicle": vehicle.token,
            "bound_g": FORCE_BOUNDS_G[vehicle.token],
            "planned_at_knots_g": round(float(predicted[i]), 3),
            **{
                f"{plant}_{what}": round(trial[plant][what][i], 3)
                for plant in PLANTS
                for what in ("force_g", "error_cm")
            },
        }
        for i, vehicle in enumerate(plan.team)
    ]


def passing_order(plan: SwarmPlan) -> str:
    """Return the vehicles from below where the large robot and its nearest neighbor in y pass."""
    large = [vehicle.token for vehicle in plan.team].index("L")
    position = plan.trajectories.position
    apart = np.abs(position[:, :, 1] - position[:, [large], 1])
    apart[:, large] = np.inf
    knot = int(apart.min(axis=1).argmin())
    near = [large, int(apart[knot].argmin())]
    heights = position[knot, near, 2]
    return " below ".join(plan.team[near[k]].token for k in np.argsort(heights))


def plot_figure_6(path: Path, plans: Mapping[str, SwarmPlan], model: InteractionModel) -> None:
    """Draw stage 1, stage 2 as tracked, and the plan without the forces as tracked."""
    columns = [
        PlanColumn(
            "Stage 1, knowing the forces",
            plans["aware"].initial.times,
            plans["aware"].initial.position,
            plans["aware"].initial.forces,
        )
    ]
    titles = {"aware": "Stage 2, knowing the forces", "unaware": "Not knowing the forces"}
    for planner, title in titles.items():
        track = track_plan(plans[planner].trajectories, plans[planner].team, model)
        columns.append(PlanColumn(title, track.time, track.position, track.force))
    headline = "Fig. 6: a swap, tracked by a PID in the air that the model knows"
    draw_columns(path, plans["aware"], columns, headline)


def compare_6(
    rows: Sequence[Mapping[str, Any]], orders: Mapping[str, Mapping[str, int]]
) -> list[Row]:
    """Compare the forces of both plans with their bounds, and who passes above whom."""

    def worst(planner: str, tokens: str, what: str = "force_g") -> float:
        own = [r for r in rows if r["planner"] == planner and r["vehicle"] in tokens]
        return max(float(r[f"model_plant_{what}"]) for r in own)

    error = "worst tracking error, cm"
    aware, unaware = (worst(p, "SL", "error_cm") for p in ("aware", "unaware"))
    small = "force on a small robot, g"
    return [
        Row(f"aware plan: {small}", "within the bound of 5", worst("aware", "S"), (0.0, 5.0)),
        Row(
            f"aware plan: very small {small}",
            "very small",
            worst("aware", "S"),
            (0.0, 1.0),
            BOUNDED,
        ),
        Row(
            "aware plan: force on the large robot, g",
            "within the bound of 10",
            worst("aware", "L"),
            (0.0, 10.0),
        ),
        Row(f"aware plan: {error}", "not significant", aware, (0.0, 2.0)),
        Row(
            f"unaware plan: {small}",
            "beyond the bound of 5",
            worst("unaware", "S"),
            (5.0, math.inf),
        ),
        Row(
            f"unaware plan: {error}",
            "significant",
            unaware,
            (5.0, math.inf),
            OTHER_SWAP,
            (1.0, math.inf),
        ),
        *(
            Row(
                f"share of plans that send the large robot below, {planner}",
                BELOW_SHARE[planner][0],
                own.get("L below S", 0) / sum(own.values()),
                BELOW_SHARE[planner][1],
                LOCAL,
            )
            for planner, own in orders.items()
        ),
    ]


# ---- Fig. 7


def figure_7(
    out: Path = Path("neural_swarm2"),
    truth: str = "learned",
    engine: str = default_engine(),
    scenarios: tuple[str, ...] = SCENARIOS,
    trials: int = 5,
    seed: int = 0,
) -> None:
    """Plan and fly random swaps, with and without knowing the forces (Fig. 7).

    Writes `figure_7.json` (`rows`: worst errors and forces by plant, team and planner; `trials`)
    and three pictures, of which `figure_7.png` is the paper's: on the planner's own model.

    Args:
        out: folder, made if missing.
        truth: force model of the environment, `learned` or `wake`; the planner knows a fitted one.
        engine: of the flights, `bullet` or `batch`.
        scenarios: teams that exchange positions.
        trials: random swaps of each team.
        seed: the first of their seeds.
    """
    model = load_belief(truth)
    jobs = [(t, s, p) for t in scenarios for s in range(seed, seed + trials) for p in PLANNERS]
    found = {}
    for team, s, planner in tqdm(jobs, "Fig. 7", unit="trial"):
        swap = draw_swap(team, s)
        plan = plan_swap(swap, model, planner, s)
        trial = fly_trial(swap, plan, planner, s, model, truth, engine)
        found[f"{team}, {planner}, {s}"] = trial
    rows = {plant: scenario_rows(found.values(), plant) for plant in PLANTS}
    summary = {
        "seed": seed,
        "truth": truth,
        "engine": engine,
        "model": model.fingerprint,
        "rows": rows,
        "not_converged": [n for n, c in found.items() if c["plan"]["status"] != "converged"],
        "crashed": {s: [n for n, c in found.items() if c[s]["crashed"]] for s in SIDES},
        "trials": found,
    }
    write_compared(out / "figure_7.json", summary, compare_7(rows["model_plant"]))
    for plant, title in PLANTS.items():
        name = "figure_7.png" if plant == "model_plant" else f"figure_7_{plant}.png"
        plot_trials(out / name, list(found.values()), f"Fig. 7 {title}", plant)
        print(f"{title}: worst of all trials", markdown(rows[plant], COLUMNS), sep="\n")
    print(f"plans that did not converge: {summary['not_converged']}")
    print(f"crashed in (b): {summary['crashed']}")


def scenario_rows(
    trials: Iterable[Mapping[str, Any]], plant: str = "model_plant"
) -> list[dict[str, Any]]:
    """Return a row for each team and planner of the trials, of what a plant has measured."""
    grouped: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for trial in trials:
        grouped.setdefault((trial["scenario"], trial["planner"]), []).append(trial[plant])
    return [_scenario_row(*key, found) for key, found in grouped.items()]


def _scenario_row(
    scenario: str, planner: str, found: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    errors = [max(f["error_cm"]) for f in found]
    ratios = [f["over_bound"] for f in found]
    return {
        "scenario": scenario,
        "planner": planner,
        "trials": len(found),
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
    """Return the largest force on any vehicle of a type in each trial, g; empty if none has it."""
    own = [i for i, vehicle in enumerate(parse_team(scenario)) if vehicle.token == token]
    return [max(f["force_g"][i] for i in own) for f in found] if own else []


def plot_trials(path: Path, trials: Sequence[Mapping[str, Any]], headline: str, plant: str) -> None:
    """Draw worst error and worst force of each trial; bars reach to the worst of all."""
    scenarios = list(dict.fromkeys(trial["scenario"] for trial in trials))
    with picture(path, 12.0, 4.6, headline) as figure:
        axes = figure.subplots(1, 3)
        for planner in LOOKS:
            own = [trial for trial in trials if trial["planner"] == planner]
            found = {s: [c[plant] for c in own if c["scenario"] == s] for s in scenarios}
            worst = {s: [max(f["error_cm"]) for f in each] for s, each in found.items()}
            _plot_dots(axes[0], worst, planner)
            for axis, token in zip(axes[1:], "SL", strict=True):
                forces = {s: _forces_on(s, token, each) for s, each in found.items()}
                _plot_dots(axis, {s: each for s, each in forces.items() if each}, planner)
        axes[0].set(title="Worst tracking error", ylabel="Error (cm)")
        for axis, token, size in zip(axes[1:], "SL", ("small", "large"), strict=True):
            bound = FORCE_BOUNDS_G[token]
            axis.axhline(bound, color="#C0202A", linewidth=1.4)
            axis.set(title=f"Worst force on {size} ones, bound {bound:g} g", ylabel="|f_a,z| (g)")
        for axis in axes:
            axis.grid(True, axis="y")
        axes[0].margins(y=0.2)
        axes[0].legend(fontsize=9, loc="upper right")


def _plot_dots(axis: Axes, values: Mapping[str, Sequence[float]], planner: str) -> None:
    color, offset, label = LOOKS[planner]
    place = np.arange(len(values)) + offset
    highest = [max(own) for own in values.values()]
    axis.bar(place, highest, 0.3, color=color, alpha=0.35, label=label)
    for x, own in zip(place, values.values(), strict=True):
        spread = x + np.linspace(-0.1, 0.1, len(own)) * (len(own) > 1)
        axis.plot(spread, own, "o", color=color, markersize=4, markeredgecolor="white",
                  markeredgewidth=0.4)  # fmt: skip
    axis.set_xticks(range(len(values)), list(values), color=INK)


def compare_7(rows: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Compare worst forces and errors on the planner's model with what the paper's text says."""
    unaware, aware = ([r for r in rows if r["planner"] == planner] for planner in PLANNERS)
    own = {row["scenario"]: row for row in unaware}
    found = [
        Row(
            f"{team}, unaware: worst force over its bound",
            "nearly double",
            own[team]["worst_over_bound"],
            (1.6, 2.4),
            SAMPLED,
            (1.2, 3.0),
        )
        for team in ("SL", "SSL", "LL")
        if team in own
    ]
    if "SL" in own:
        small = own["SL"]["worst_force_S_g"]
        what = "SL, unaware: worst force on the small robot, g"
        found.append(Row(what, "greater than 10", small, (10.0, math.inf), SAMPLED, (6.0, 10.0)))
    error = "worst tracking error of all scenarios, cm"
    return [
        *found,
        Row(f"unaware: {error}", "over 10", _most(unaware, "worst_error_cm"), (10.0, math.inf)),
        Row(
            "aware: worst force over its bound, all scenarios",
            "at most 1",
            _most(aware, "worst_over_bound"),
            (0.0, 1.0),
        ),
        Row(f"aware: {error}", "-", _most(aware, "worst_error_cm")),
    ]


def _most(rows: Iterable[Mapping[str, Any]], name: str) -> float:
    return max(float(row[name]) for row in rows)
