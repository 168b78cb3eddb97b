"""Lag compensation with an exact force: what eq. (22) buys, and cells that are kept."""

from __future__ import annotations

import csv

import pytest

from swarm_envs.files import write_table
from swarm_envs.training.reproduce.lag_study import LAG_VARIANTS
from swarm_envs.training.reproduce.study import draw_seeds, run_cells
from tests.helpers.papers import run_quietly


def test_variants_differ_in_what_they_say_alone():
    configs = {(v.gains, v.oracle, v.lag): v.controller for v in LAG_VARIANTS}
    assert len(configs) == 12
    on, off = configs["mid", True, True], configs["mid", True, False]
    assert on.feedforward is not None
    assert (on.lag_compensation, off.lag_compensation) == (True, False)
    assert on.gains == off.gains == configs["mid", False, True].gains
    assert configs["mid", False, True].feedforward is None


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
    with (tmp_path / "lag.csv").open(newline="") as file:
        assert [row["gains"] for row in csv.DictReader(file)][:4] == ["soft"] * 4
    assert (tmp_path / "lag.png").stat().st_size > 20_000
    assert f"{summary['reductions']['exact']['mid']:.1f}" in said
    assert run_quietly("neural-swarm2", seed=3, **asked)[0] == summary
    with pytest.raises(ValueError, match="made with other seed"):
        run_quietly("neural-swarm2", seed=4, **asked)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_the_claim_on_twenty_swaps(engine, tmp_path):
    if engine == "bullet":
        pytest.importorskip("pybullet")
    asked = {"study": "lag", "episodes": 20, "engine": engine, "out": tmp_path}
    summary, _ = run_quietly("neural-swarm2", **asked)
    assert min(summary["reductions"]["exact"].values()) >= 20.0


def test_cells_of_other_settings_and_damaged_ones_are_refused(tmp_path):
    path = tmp_path / "cells.json"
    found = run_cells({"a": lambda: {"value": 1}}, path, {"seed": 0}, progress=False)
    assert found == {"a": {"value": 1}}
    with pytest.raises(ValueError, match="made with other seed"):
        run_cells({}, path, {"seed": 1}, progress=False)
    path.write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        run_cells({}, path, {"seed": 0}, progress=False)


def test_bad_numbers_are_refused(tmp_path):
    assert draw_seeds(0, 3) == draw_seeds(0, 4)[:3]
    with pytest.raises(ValueError, match="seed is -1"):
        draw_seeds(-1, 3)
    with pytest.raises(ValueError, match="flights is 0"):
        draw_seeds(0, 0)
    with pytest.raises(ValueError, match="no row"):
        write_table(tmp_path / "empty.csv", [])
