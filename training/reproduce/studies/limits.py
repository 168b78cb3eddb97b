"""Where compensation ends: how its gain falls as belief, sensors, motors or density get worse.

Every point is stacked swaps flown by the baseline and by the compensating controller, which share
swaps, gains and sensors. In the sweeps of imperfections the belief is the environment's own model,
an oracle, spoiled in one way: what is lost is lost to that. In the others the belief that ships
flies beside the oracle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import quartiles
from swarm_envs.files import write_json, write_table
from swarm_envs.training.reproduce.runs import Cell, draw_seeds, run_cells
from swarm_envs.training.reproduce.studies.imperfect import fly_imperfectly
from swarm_envs.training.reproduce.studies.limits_plot import plot_limits
from swarm_envs.training.reproduce.studies.sweeps import TRUTH, Point, Sweep, all_sweeps


def reproduce_limits(
    out: Path,
    seed: int = 0,
    episodes: int = 20,
    progress: bool = True,
    sweeps: Sequence[Sweep] | None = None,
) -> dict[str, Any]:
    """Fly every point of every sweep; write `limits.json`, `limits.csv` and `limits.png`.

    Args:
        out: folder, made if missing; `limits_cells.json` there keeps what was flown.
        seed: seeds of the swaps are drawn from it.
        episodes: flights of each point.
        progress: show a progress bar.
        sweeps: what is varied; None for `all_sweeps()`.

    Returns:
        The numbers, ready for JSON.

    Raises:
        ValueError: the folder holds the study with other settings.
    """
    seeds = draw_seeds(seed, episodes)
    settings = {"seed": seed, "episodes": episodes, "truth": TRUTH, "engine": "batch"}
    chosen = all_sweeps() if sweeps is None else sweeps
    jobs = {p.cell: partial(measure, p, seeds) for sweep in chosen for p in sweep.points}
    cells = run_cells(out / "limits_cells.json", settings, jobs, progress)
    rows = [row for sweep in chosen for row in sweep_rows(sweep, cells)]
    summary = {**settings, "rows": rows, "hurts": [hurt for s in chosen for hurt in hurts(s, rows)]}
    write_json(out / "limits.json", summary)
    write_table(out / "limits.csv", rows)
    plot_limits(out / "limits.png", chosen, rows)
    return summary


def measure(point: Point, seeds: Sequence[int]) -> Cell:
    """Fly one point: worst height error of the lowest drone in each flight, cm."""
    flown = fly_imperfectly(point.test, point.controller, seeds, point.imperfection)
    return {
        "worst_cm": np.round(100.0 * flown.height_error[:, -1], 4).tolist(),
        "crashed": int(flown.crashed.sum()),
    }


def sweep_rows(sweep: Sweep, cells: Mapping[str, Cell]) -> list[dict[str, Any]]:
    """One row for each point with a belief, the baseline's numbers beside it."""
    alone = {(p.case, p.value): cells[p.cell] for p in sweep.points if p.belief == "none"}
    return [
        {"sweep": sweep.name, **_row(point, cells[point.cell], alone[point.case, point.value])}
        for point in sweep.points
        if point.belief != "none"
    ]


def _row(point: Point, flown: Cell, baseline: Cell) -> dict[str, Any]:
    with_it, without = np.array(flown["worst_cm"]), np.array(baseline["worst_cm"])
    mine, theirs = quartiles(with_it), quartiles(without)
    return {
        "case": point.case,
        "belief": point.belief,
        "value": point.value,
        "without_cm": round(theirs["median"], 3),
        "compensated_cm": round(mine["median"], 3),
        "lower_quartile_cm": round(mine["lower_quartile"], 3),
        "upper_quartile_cm": round(mine["upper_quartile"], 3),
        "ratio": round(mine["median"] / theirs["median"], 4),
        "made_worse": int((with_it > without).sum()),
        "episodes": len(with_it),
        "crashed_without": baseline["crashed"],
        "crashed": flown["crashed"],
    }


def hurts(sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Where the compensated median becomes the larger one, between two points of the sweep.

    Returns:
        For each crossing the case, the belief and the value, interpolated linearly in the ratio.
    """
    found = []
    own = [row for row in rows if row["sweep"] == sweep.name]
    for case, belief in dict.fromkeys((row["case"], row["belief"]) for row in own):
        line = [row for row in own if (row["case"], row["belief"]) == (case, belief)]
        for a, b in pairwise(line):
            if (a["ratio"] > 1.0) != (b["ratio"] > 1.0):
                share = (1.0 - a["ratio"]) / (b["ratio"] - a["ratio"])
                value = a["value"] + share * (b["value"] - a["value"])
                side = "above" if b["ratio"] > 1.0 else "below"
                found.append(
                    {"sweep": sweep.name, "case": case, "belief": belief, "side": side,
                     "value": round(value, 3)}
                )  # fmt: skip
    return found


def format_limits(summary: Mapping[str, Any]) -> str:
    """Every point, and where compensation hurts, as text."""
    lines = [
        f"Worst height error of the lowest drone, median of {summary['episodes']} swaps (cm)",
        f"{'sweep':16}{'case':10}{'belief':9}{'value':>8}{'without':>10}{'compensated':>13}"
        f"{'ratio':>8}{'worse':>8}{'crashed':>10}",
    ]
    for r in summary["rows"]:
        lines.append(
            f"{r['sweep']:16}{r['case']:10}{r['belief']:9}{r['value']:8g}{r['without_cm']:10.2f}"
            f"{r['compensated_cm']:13.2f}{r['ratio']:8.2f}{r['made_worse']:8d}"
            f"{r['crashed_without']:6d} /{r['crashed']:2d}"
        )
    lines.append("compensation makes the median worse:")
    for h in summary["hurts"]:
        lines.append(
            f"  {h['sweep']} {h['side']} {h['value']:g} ({h['case']}, belief {h['belief']})"
        )
    if not summary["hurts"]:
        lines.append("  nowhere")
    for r in summary["rows"]:
        if r["crashed"] > r["crashed_without"]:
            lines.append(
                f"compensation crashes {r['crashed']} of {r['episodes']}, the baseline "
                f"{r['crashed_without']}: {r['sweep']} {r['value']:g} ({r['case']}, belief "
                f"{r['belief']})"
            )
    return "\n".join(lines)
