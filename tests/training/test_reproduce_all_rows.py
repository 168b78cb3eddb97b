"""How measured numbers are set beside the papers': from files as the commands write them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.training.reproduce.everything import dmpc_swarm_rows as dmpc
from swarm_envs.training.reproduce.everything import neural_swarm_rows as neural
from swarm_envs.training.reproduce.everything import neural_swarm_tables as tables
from swarm_envs.training.reproduce.everything import rth3d_rows as grids
from swarm_envs.training.reproduce.everything.rows import Row


def written(folder: Path, name: str, content: Mapping[str, Any]) -> Path:
    (folder / name).write_text(json.dumps(content))
    return folder


def by_name(rows: list[Row]) -> dict[str, Row]:
    found = {row.quantity: row for row in rows}
    assert len(found) == len(rows)
    return found


def spread(median: float) -> dict[str, float]:
    return {"median": median, "lower_quartile": 0.9 * median, "upper_quartile": 1.1 * median}


def swap(name: str, before: float, after: float, p_value: float) -> dict[str, Any]:
    ratio = after / before
    sides = {"without": spread(before), "compensated": spread(after)}
    return {"case": name, "paper_cm": (17.0, 7.0), "ratio": ratio, "p_value": p_value, **sides}


def test_swaps_stand_beside_the_paper_s_medians(tmp_path):
    cases = [swap("L2S", 16.0, 0.5, 0.03), swap("S2S", 9.0, 9.5, 0.4)]
    air = {"truth": {"name": "wake"}, "cases": cases}
    rows = by_name(neural.swaps(written(tmp_path, "figure_8.json", {"truths": [air]}), "quick"))
    without, with_ = (rows[f"`wake` air, L2S: error {side}, cm"] for side in ("without", "with"))
    assert (without.ours, without.verdict, with_.verdict) == (16.0, "agrees", "explained")
    assert with_.spread == pytest.approx((0.45, 0.55)) and "hall" in with_.reason.text
    improving = rows["`wake` air: share of cases whose median improves"]
    assert (improving.ours, improving.verdict) == (0.5, "unexplained")


def test_a_larger_error_than_the_paper_s_is_not_explained_by_calmer_air(tmp_path):
    air = {"truth": {"name": "wake"}, "cases": [swap("L2S", 17.0, 12.0, 0.03)]}
    rows = by_name(neural.swaps(written(tmp_path, "figure_8.json", {"truths": [air]}), "full"))
    assert rows["`wake` air, L2S: error with, cm"].verdict == "unexplained"


def cell(total: list[float | None], least: float) -> dict[str, Any]:
    legs = [[] if t is None else [t / 4] * 4 for t in total]
    seeds = list(range(len(total)))
    arrived = sum(t is not None for t in total)
    return {
        "seeds": seeds,
        "total_s": total,
        "legs_s": legs,
        "arrived": arrived,
        "least_scaled_distance_m": [least] * len(total),
    }


def test_compute_units_by_what_they_save(tmp_path):
    times = {"1 CU": [70.0], "2 CUs": [45.0], "3 CUs": [60.0, 40.0, 36.0]}
    cells = {name: cell(list(t), 0.25) for name, t in times.items()}
    rows = by_name(dmpc.figure_3b(written(tmp_path, "figure_3b.json", {"cells": cells}), "full"))
    saved = rows["time that the second unit saves over what the third saves"]
    assert (saved.ours, saved.verdict) == (5.0, "agrees")
    assert rows["3 CUs: all four changes of formation, s"].spread == (36.0, 60.0)
    assert {row.verdict for row in rows.values()} == {"agrees"}


def test_a_jam_without_recovery(tmp_path):
    cells = {
        "jam, ours": cell([None], 0.2),
        "jam, paper's": cell([31.0], 0.25),
        "jam, none": cell([20.0], 0.05),
    }
    rows = by_name(dmpc.figure_4(written(tmp_path, "figure_4.json", {"cells": cells}), "quick"))
    nearest = "least scaled distance of two references, m"
    assert rows[f"our recovery: {nearest}"].verdict == "unexplained"
    assert rows[f"the paper's recovery: {nearest}"].verdict == "agrees"
    assert rows[f"without recovery: {nearest}"].verdict == "agrees"
    assert rows["our recovery: share of runs in which all arrive"].ours == 0.0
    assert rows["our recovery: time to the last arrival, s"].verdict == "unexplained"


def point(grid: str, method: str, before: float, robots: int = 100) -> dict[str, Any]:
    ends = {f"ratio_before_compaction{end}": before for end in ("", "_least", "_most")}
    ends |= {f"ratio{end}": before - 0.2 for end in ("", "_least", "_most")}
    own = {"series": "uniform", "grid": grid, "method": method, "robots": robots, "runs": 2}
    return own | ends


@pytest.mark.parametrize(
    ("preset", "largest", "verdict"),
    [
        ("full", 1.68, "agrees"),
        ("full", 1.55, "explained"),  # shorter than the paper's
        ("full", 1.9, "unexplained"),
        ("quick", 1.9, "explained"),  # a small grid
    ],
)
def test_ratios_of_makespans(tmp_path, preset, largest, verdict):
    points = [
        point(grid, method, value)
        for method in ("rth3d", "rth3d-lba", "auto")
        for grid, value in (("12x6x3", 2.5), ("48x24x12", largest))
    ]
    rows = by_name(grids.figure_5(written(tmp_path, "points.json", {"points": points}), preset))
    assert rows["uniform 48 x 24 x 12, `rth3d`: ratio before compaction"].verdict == verdict
    fallen = rows["uniform, `rth3d`: ratio on the largest grid over the smallest"]
    assert (fallen.ours, fallen.verdict) == (largest / 2.5, "agrees")


def test_a_curve_that_is_not_there_is_named(tmp_path):
    written(tmp_path, "points.json", {"points": []})
    with pytest.raises(ValueError, match="no curve of 'rth3d' on 'uniform'"):
        grids.figure_6(tmp_path, "full")


def test_table_3_by_ratios_to_its_first_cell(tmp_path):
    names = {"H=20,L=4": (6.42, 6.4), "L=5": (7.21, 6.5), "no-relative-velocity": (7.6, 7.2)}
    rows = [
        {
            "cell": name,
            "paper_g2": paper,
            "paper_deviation_g2": None,
            "ours_g2": ours,
            "ours_deviation_g2": 0.05,
        }
        for name, (paper, ours) in names.items()
    ]
    rows.append({"cell": "pairwise", "paper_g2": None})
    found = by_name(tables.ablation(written(tmp_path, "table_3.json", {"rows": rows}), "full"))
    assert found["H=20,L=4: validation error, g²"].verdict == "agrees"
    deep = found["L=5: error over that of H=20,L=4"]
    assert deep.ours == pytest.approx(6.5 / 6.4) and deep.verdict == "explained"
    assert found["no-relative-velocity: error over that of H=20,L=4"].verdict == "agrees"
    assert len(found) == 5
