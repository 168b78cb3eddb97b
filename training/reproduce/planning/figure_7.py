"""Fig. 7: five scenarios and more, five trials each, planned knowing the forces and not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.files import write_json, write_table
from swarm_envs.training.reproduce.planning.figure_7_plot import plot_figure_7
from swarm_envs.training.reproduce.planning.scenarios import SCENARIOS, TRIALS, draw_swap
from swarm_envs.training.reproduce.planning.summary import format_rows, scenario_rows, verdicts
from swarm_envs.training.reproduce.planning.trials import (
    ATTEMPTS,
    PLANNED_SHARE,
    PLANNERS,
    SIDES,
    TrialSettings,
    fly_trial,
    kept_plan,
)
from swarm_envs.training.reproduce.runs import Cell, draw_seeds, run_cells

PLANTS: Mapping[str, str] = {
    "model_plant": "(a) the planner's own model, tracked by a PID, no compensation",
    "plain": "(b) quadrotors in unknown air, no compensation",
    "compensated": "(b) quadrotors in unknown air, compensated",
}
"""In what plans are flown, and how the tables say it."""


def reproduce_figure_7(
    out: Path,
    seed: int = 0,
    scenarios: Sequence[str] = SCENARIOS,
    trials: int = TRIALS,
    truth: str = "learned",
    engine: str = "batch",
    progress: bool = True,
) -> dict[str, Any]:
    """Plan and fly every trial; write `figure_7.json`, `.csv` and `.png`, and the plans.

    Args:
        out: folder, made if missing. `figure_7_cells.json` there keeps what was flown, and the
            folder `plans` what was planned.
        seed: of the first trial of every scenario; the next ones follow.
        scenarios: teams.
        trials: of each.
        truth: the force that blows in (b); planner and controller believe what ships for it.
        engine: of (b).
        progress: show a progress bar.

    Returns:
        The numbers, ready for JSON.

    Raises:
        ValueError: a scenario or number that cannot be, or a folder with other settings.
    """
    draw_seeds(seed, trials)
    model = load_belief(truth)
    settings = TrialSettings(model, truth, engine)
    about = {
        "seed": seed,
        "truth": truth,
        "engine": engine,
        "model": model.fingerprint,
        "planned_share": PLANNED_SHARE,
        "attempts": ATTEMPTS,
    }
    jobs = {
        f"{team}, {planner}, {s}": partial(_trial, out, settings, team, planner, s)
        for team in scenarios
        for s in range(seed, seed + trials)
        for planner in PLANNERS
    }
    cells = list(run_cells(out / "figure_7_cells.json", about, jobs, progress).values())
    rows = {plant: scenario_rows(cells, plant) for plant in PLANTS}
    summary = {
        **about,
        "trials": trials,
        "rows": rows,
        "verdicts": verdicts(rows["model_plant"]),
        "not_converged": [_name(c) for c in cells if c["plan"]["status"] != "converged"],
        "crashed": {s: [_name(c) for c in cells if c[s]["crashed"]] for s in SIDES},
        "cells": cells,
    }
    write_json(out / "figure_7.json", summary)
    write_table(out / "figure_7.csv", [{"plant": p, **r} for p in PLANTS for r in rows[p]])
    for plant, title in PLANTS.items():
        name = "figure_7" if plant == "model_plant" else f"figure_7_{plant}"
        plot_figure_7(out / f"{name}.png", cells, f"Fig. 7 {title}", plant)
    return summary


def _name(cell: Cell) -> str:
    return f"{cell['scenario']}, {cell['planner']}, {cell['seed']}"


def _trial(out: Path, settings: TrialSettings, team: str, planner: str, seed: int) -> Cell:
    """Plan, or read the plan that is kept, and fly."""
    swap, path = draw_swap(team, seed), out / "plans" / f"{team}_{planner}_{seed}.npz"
    plan = kept_plan(path, settings, swap, planner, seed)
    return fly_trial(settings, swap, plan, planner, seed)


def format_figure_7(summary: Mapping[str, Any]) -> str:
    """Tables of every plant, and the claims, as text."""
    parts = [format_rows(summary["rows"][plant], title) for plant, title in PLANTS.items()]
    said = summary["verdicts"]
    within, smaller = _yes(said["aware_within_bound"]), _yes(said["aware_error_smaller"])
    violated = ", ".join(f"{s}: {_yes(v)}" for s, v in said["unaware_violates"].items())
    claims = [
        f"(a) aware planner within 1.1 of the bounds in every trial: {within}",
        f"(a) its worst error smaller in every scenario: {smaller}",
        f"(a) unaware planner breaks a bound, as in the paper: {violated}",
        f"plans that did not converge: {'; '.join(summary['not_converged']) or 'none'}",
        f"crashed in (b): {_crashes(summary['crashed'])}",
    ]
    return "\n\n".join([*parts, "\n".join(claims)])


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


def _crashes(crashed: Mapping[str, Sequence[str]]) -> str:
    found = [f"{name} ({side})" for side, names in crashed.items() for name in names]
    return "; ".join(found) or "none"
