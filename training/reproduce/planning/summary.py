"""The numbers of Fig. 7 from its trials: worst errors and forces, by scenario and planner."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.training.reproduce.planning.trials import PLANNERS
from swarm_envs.vehicles import parse_team

ALLOWED = 1.1
"""Largest force over its bound that the aware planner may have, in any trial."""
PAPER_VIOLATIONS = ("SL", "SSL", "LL")
"""Scenarios in which the paper's unaware planner "consistently" nearly doubles its bound."""


def scenario_rows(
    cells: Iterable[Mapping[str, Any]], plant: str = "model_plant"
) -> list[dict[str, Any]]:
    """One row for each scenario and planner.

    Args:
        cells: as `fly_trial` returns them.
        plant: whose measures: the key in the cells.
    """
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
        **{f"worst_force_{token}_g": _worst_force(scenario, token, found) for token in "SL"},
        "worst_over_bound": round(max(ratios), 3),
        "trials_over_bound": sum(ratio > 1.0 for ratio in ratios),
        "least_clearance": round(min(f["clearance"] for f in found), 3),
        "errors_cm": [round(error, 3) for error in errors],
        "over_bound": [round(ratio, 3) for ratio in ratios],
    }


def _worst_force(scenario: str, token: str, found: Sequence[Mapping[str, Any]]) -> float | None:
    """Largest force on any vehicle of a type, g; None where there is none."""
    own = [i for i, vehicle in enumerate(parse_team(scenario)) if vehicle.token == token]
    forces = [f["force_g"][i] for f in found for i in own]
    return round(max(forces), 3) if forces else None


def verdicts(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Whether the claims of Fig. 7 hold in these rows, claim by claim."""
    by = {(row["scenario"], row["planner"]): row for row in rows}
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    unaware, aware = PLANNERS
    return {
        "aware_within_bound": all(by[s, aware]["worst_over_bound"] <= ALLOWED for s in scenarios),
        "aware_error_smaller": all(
            by[s, aware]["worst_error_cm"] < by[s, unaware]["worst_error_cm"] for s in scenarios
        ),
        "unaware_violates": {
            s: by[s, unaware]["worst_over_bound"] > 1.0 for s in PAPER_VIOLATIONS if s in scenarios
        },
    }


def format_rows(rows: Sequence[Mapping[str, Any]], title: str) -> str:
    """The rows as text."""
    lines = [
        title,
        f"{'scenario':10}{'planner':10}{'error (cm)':>12}{'force S (g)':>13}{'force L (g)':>13}"
        f"{'over bound':>12}{'trials over':>13}",
    ]
    for row in rows:
        forces = "".join(
            f"{'-':>13}" if row[key] is None else f"{row[key]:13.2f}"
            for key in ("worst_force_S_g", "worst_force_L_g")
        )
        over = f"{row['trials_over_bound']} of {row['trials']}"
        lines.append(
            f"{row['scenario']:10}{row['planner']:10}{row['worst_error_cm']:12.2f}{forces}"
            f"{row['worst_over_bound']:12.2f}{over:>13}"
        )
    bounds = ", ".join(f"{FORCE_BOUNDS_G[token]:g} g ({token})" for token in "SL")
    lines.append(f"worst of all trials; bounds {bounds}")
    return "\n".join(lines)
