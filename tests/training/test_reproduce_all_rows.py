"""How measured numbers are set beside the papers': from numbers as the studies write them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from swarm_envs.training.reproduce.ablation import ablation_claims
from swarm_envs.training.reproduce.claims import Claim, Extent
from swarm_envs.training.reproduce.papers import numbered_studies

STUDIES = numbered_studies()


def claims_of(key: str, numbers: Any, quick: bool = False) -> dict[str, Claim]:
    claims = STUDIES[key].claims
    assert claims is not None
    return by_name(claims(numbers, Extent(quick)))


def by_name(claims: Iterable[Claim]) -> dict[str, Claim]:
    listed = list(claims)
    found = {claim.quantity: claim for claim in listed}
    assert len(found) == len(listed)
    return found


def spread(median: float) -> dict[str, float]:
    return {"median": median, "lower_quartile": 0.9 * median, "upper_quartile": 1.1 * median}


def swap(name: str, before: float, after: float, p_value: float) -> dict[str, Any]:
    ratio = after / before
    sides = {"without": spread(before), "compensated": spread(after)}
    return {"case": name, "paper_cm": (17.0, 7.0), "ratio": ratio, "p_value": p_value, **sides}


def test_swaps_stand_beside_the_paper_s_medians():
    cases = [swap("L2S", 16.0, 0.5, 0.03), swap("S2S", 9.0, 9.5, 0.4)]
    air = {"truth": {"name": "wake"}, "cases": cases}
    rows = claims_of("neural-swarm2/figure-8", {"truths": [air]}, quick=True)
    without, with_ = (rows[f"`wake` air, L2S: error {side}, cm"] for side in ("without", "with"))
    assert (without.ours, without.agreement, with_.agreement) == (16.0, "agrees", "explained")
    assert with_.spread == pytest.approx((0.45, 0.55))
    assert with_.reason is not None and "hall" in with_.reason.text
    improving = rows["`wake` air: share of cases whose median improves"]
    assert (improving.ours, improving.agreement) == (0.5, "unexplained")


def test_a_larger_error_than_the_paper_s_is_not_explained_by_calmer_air():
    air = {"truth": {"name": "wake"}, "cases": [swap("L2S", 17.0, 12.0, 0.03)]}
    rows = claims_of("neural-swarm2/figure-8", {"truths": [air]})
    assert rows["`wake` air, L2S: error with, cm"].agreement == "unexplained"


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


def test_compute_units_by_what_they_save():
    times = {"1 CU": [70.0], "2 CUs": [45.0], "3 CUs": [60.0, 40.0, 36.0]}
    cells = {name: cell(list(t), 0.25) for name, t in times.items()}
    rows = claims_of("dmpc-swarm/figure-3b", {"cells": cells})
    saved = rows["time that the second unit saves over what the third saves"]
    assert (saved.ours, saved.agreement) == (5.0, "agrees")
    assert rows["3 CUs: all four changes of formation, s"].spread == (36.0, 60.0)
    assert {row.agreement for row in rows.values()} == {"agrees"}


def test_a_jam_without_recovery():
    cells = {
        "jam, ours": cell([None], 0.2),
        "jam, paper's": cell([31.0], 0.25),
        "jam, none": cell([20.0], 0.05),
    }
    rows = claims_of("dmpc-swarm/figure-4", {"cells": cells}, quick=True)
    nearest = "least scaled distance of two references, m"
    assert rows[f"our recovery: {nearest}"].agreement == "unexplained"
    assert rows[f"the paper's recovery: {nearest}"].agreement == "agrees"
    assert rows[f"without recovery: {nearest}"].agreement == "agrees"
    assert rows["our recovery: share of runs in which all arrive"].ours == 0.0
    assert rows["our recovery: time to the last arrival, s"].agreement == "unexplained"


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
        ("quick", 1.58, "explained"),
    ],
)
def test_ratios_of_makespans(preset, largest, verdict):
    points = [
        point(grid, method, value)
        for method in ("rth3d", "rth3d-lba", "auto")
        for grid, value in (("12x6x3", 2.5), ("48x24x12", largest))
    ]
    rows = claims_of("rth3d/figure-5", {"points": points}, preset == "quick")
    assert rows["uniform 48 x 24 x 12, `rth3d`: ratio before compaction"].agreement == verdict
    ratio = rows["uniform 48 x 24 x 12, `rth3d`: ratio before compaction"]
    if ratio.reason is not None:  # small grids have larger ratios, never smaller ones
        assert ("--quick" in ratio.reason.text) == (largest > 1.7)
    fallen = rows["uniform, `rth3d`: ratio on the largest grid over the smallest"]
    assert (fallen.ours, fallen.agreement) == (largest / 2.5, "agrees")


def test_a_curve_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="no curve of 'rth3d' on 'uniform'"):
        claims_of("rth3d/figure-6", {"points": []})


def test_table_3_by_ratios_to_its_first_cell():
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
    found = by_name(ablation_claims({"rows": rows}, Extent()))
    assert found["H=20,L=4: validation error, g²"].agreement == "agrees"
    deep = found["L=5: error over that of H=20,L=4"]
    assert deep.ours == pytest.approx(6.5 / 6.4) and deep.agreement == "explained"
    assert found["no-relative-velocity: error over that of H=20,L=4"].agreement == "agrees"
    assert len(found) == 5
