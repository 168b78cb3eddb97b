"""Lag compensation with an exact force: what eq. (22) buys, and cells that are kept."""

from __future__ import annotations

import pytest

from tests.helpers.papers import run_quietly


def test_lag_compensation_cuts_the_compensated_error_to_a_quarter(tmp_path):
    asked = {"study": "lag", "episodes": 4, "engine": "batch", "out": tmp_path}
    summary, said = run_quietly("neural-swarm2", seed=3, **asked)
    assert set(summary["reductions"]["exact"]) == {"soft", "mid", "stiff"}
    assert min(summary["reductions"]["exact"].values()) >= 4.0
    assert all(1.05 < ratio < 1.4 for ratio in summary["reductions"]["none"].values())
    median = {(r["gains"], r["force"], r["lag"]): r["median_cm"] for r in summary["rows"]}
    for force in ("exact", "none"):
        soft, mid, stiff = (median[g, force, "not compensated"] for g in ("soft", "mid", "stiff"))
        assert soft > mid > stiff
    assert not any(row["crashed"] for row in summary["rows"])
    assert f"{summary['reductions']['exact']['mid']:.1f}" in said


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_the_claim_on_twenty_swaps(engine, tmp_path):
    if engine == "bullet":
        pytest.importorskip("pybullet")
    asked = {"study": "lag", "episodes": 20, "engine": engine, "out": tmp_path}
    summary, _ = run_quietly("neural-swarm2", **asked)
    assert min(summary["reductions"]["exact"].values()) >= 20.0
