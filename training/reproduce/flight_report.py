"""The flight tests' numbers: rows for JSON and CSV, tables for the terminal."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import describe_spread, format_columns
from swarm_envs.files import written_whole
from swarm_envs.state import FloatArray
from swarm_envs.tasks.ring import RingTask
from swarm_envs.training.collection.flight import vehicle_names
from swarm_envs.training.reproduce.flight_cases import Case
from swarm_envs.training.reproduce.flown import SIDES, Flown
from swarm_envs.training.reproduce.paired import compare

WORST = "worst of each flight"
"""Name of the row of rings that is judged."""


def case_row(case: Case, flown: Flown) -> dict[str, Any]:
    """Everything that is said of a case: the judged error, every drone's, force, raw errors."""
    names, team = vehicle_names(case.test.task.team), case.test.task.team
    drones = [
        {
            "drone": name,
            **_place(case, i),
            **_compared_errors(case, flown.worst_cm[..., i]),
            "force_rms_g": round(float(flown.force_rms_g[i]), 3),
            "error_rms_g": round(float(flown.error_rms_g[i]), 3),
        }
        for i, name in enumerate(names)
    ]
    return {
        "case": case.name,
        "judged": WORST if case.judged is None else names[case.judged],
        "episodes": int(flown.worst_cm.shape[1]),
        "paper_cm": case.paper_cm,
        **_compared_errors(case, flown.judged_cm(case.judged)),
        "drones": drones,
        "crashed": dict(zip(SIDES, flown.crashed.sum(axis=1).tolist())),
        "least_separation_m": dict(zip(SIDES, flown.separation_m.min(axis=1).round(4).tolist())),
        "explained": round(float(flown.explained), 4),
        "mean_neighbours": round(float(flown.neighbours[0]), 2),
        "most_neighbours": int(flown.neighbours[1]),
        "others_cm": _others(case, flown) if len(team) > 1 else None,
        "worst_height_error_cm": {
            side: np.round(flown.worst_cm[k], 3).tolist() for k, side in enumerate(SIDES)
        },
    }


def _compared_errors(case: Case, errors: FloatArray) -> dict[str, Any]:
    """Errors (2, E) compared. Flights on rings differ in their start alone: p says nothing."""
    found = compare(*errors).as_dict()
    if isinstance(case.test.task, RingTask):
        del found["p_value"], found["significant"]
    return found


def _place(case: Case, i: int) -> dict[str, str]:
    task = case.test.task
    if not isinstance(task, RingTask):
        return {"place": "lowest" if i == len(task.team) - 1 else "upper"}
    upright = task.orbit.first[i, 2] != 0.0
    return {"place": "upright ring" if upright else "level ring"}


def _others(case: Case, flown: Flown) -> dict[str, float] | None:
    """Errors of the drones above the judged one: what compensating the lowest costs them."""
    if case.judged is None:
        return None
    upper = flown.worst_cm[..., :-1]
    worst = upper.max(axis=-1)
    return {
        "without": round(float(np.median(worst[0])), 3),
        "compensated": round(float(np.median(worst[1])), 3),
        "largest_growth": round(float((upper[1] - upper[0]).max()), 3),
    }


_QUARTILES = ("median", "lower_quartile", "upper_quartile")
_COLUMNS = (
    *("truth", "case", "drone", "place", "judged", "episodes"),
    *(f"{side}_{what}_cm" for side in SIDES for what in _QUARTILES),
    *("ratio", "made_worse", "p_value", "paper_without_cm", "paper_compensated_cm"),
    *("crashed_without", "crashed_compensated", "force_rms_g", "error_rms_g"),
)  # fmt: skip


def write_csv(path: Path, report: Mapping[str, Any]) -> None:
    """Write a report's errors: one row for each drone of each case, and for what is judged.

    Raises:
        OSError: it cannot be written.
    """
    with (
        written_whole(path) as partial,
        partial.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, _COLUMNS)
        writer.writeheader()
        writer.writerows(_csv_rows(report))


def _csv_rows(report: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for air in report["truths"]:
        for row in air["cases"]:
            drones = [d | {"judged": d["drone"] == row["judged"]} for d in row["drones"]]
            if row["judged"] == WORST:
                own = {k: row[k] for k in (*SIDES, "ratio", "made_worse")}
                drones.append(own | {"drone": WORST, "judged": True})
            before, after = row["paper_cm"] or (None, None)
            for drone in drones:
                paper = (before, after) if drone["judged"] else (None, None)
                entry = {name: drone.get(name) for name in _COLUMNS} | {
                    f"{side}_{what}_cm": round(value, 4)
                    for side in SIDES
                    for what, value in drone[side].items()
                }
                yield entry | {
                    "truth": air["truth"]["name"],
                    "case": row["case"],
                    "episodes": row["episodes"],
                    "paper_without_cm": paper[0],
                    "paper_compensated_cm": paper[1],
                    "crashed_without": row["crashed"]["without"],
                    "crashed_compensated": row["crashed"]["compensated"],
                }


def format_report(report: Mapping[str, Any]) -> str:
    """A report as text: a table for each force that blew, claims, notes."""
    lines: list[str] = []
    for air in report["truths"]:
        lines += [
            f"Worst height error (cm), median (quartiles) of {report['episodes']} flights each, "
            f"{report['engine']} engine, {air['truth']['name']} forces, believed: "
            f"{air['belief']['name']}",
            "",
            *(_swap_table(air) if report["figure"] == 8 else _ring_tables(air)),
            "",
            *(
                f"{'reached' if claim['reached'] else 'MISSED'}: {claim['claim']}: {claim['found']}"
                for claim in air["claims"]
            ),
            "",
        ]
    return "\n".join([*lines, *(f"note: {note}" for note in report["notes"])]).rstrip()


_HEAD = ("without", "with", "ratio", "made worse")


def _compared(row: Mapping[str, Any], episodes: int) -> tuple[str, ...]:
    """The cells of `_HEAD`."""
    spreads = [describe_spread(row[side]) for side in SIDES]
    return (
        *spreads,
        f"{row['ratio']:.2f}",
        f"{row['made_worse']} of {episodes}",
    )


def _paper(row: Mapping[str, Any]) -> str:
    return "{:g} -> {:g}".format(*row["paper_cm"]) if row["paper_cm"] else "-"


def _swap_table(air: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [("case", *_HEAD, "p", "upper drones", "paper")]
    for row in air["cases"]:
        others = row["others_cm"]
        upper = f"{others['without']:.1f} -> {others['compensated']:.1f}"
        cells = (*_compared(row, row["episodes"]), f"{row['p_value']:.1g}", upper, _paper(row))
        rows.append((row["case"], *cells))
    return format_columns(rows)


def _ring_tables(air: Mapping[str, Any]) -> list[str]:
    lines = []
    for row in air["cases"]:
        rows: list[tuple[str, ...]] = [(row["case"], "place", *_HEAD, "force (g)", "its error (g)")]
        for drone in row["drones"]:
            force = (f"{drone['force_rms_g']:.2f}", f"{drone['error_rms_g']:.2f}")
            rows.append(
                (drone["drone"], drone["place"], *_compared(drone, row["episodes"]), *force)
            )
        rows.append((WORST, "-", *_compared(row, row["episodes"]), "-", "-"))
        lines += format_columns(rows)
        lines.append(
            f"paper, one drone of an upright ring: {_paper(row)} cm; neighbours: "
            f"{row['mean_neighbours']:.1f} on average, {row['most_neighbours']} at most; "
            f"{100 * row['explained']:.1f} % of the force's variance predicted"
        )
    return lines
