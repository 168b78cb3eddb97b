"""Lag compensation with an exact force: what eq. (22) buys, and cells that are kept."""

from __future__ import annotations

import csv
import json

import pytest

from swarm_envs.files import write_table
from swarm_envs.training.reproduce.runs import draw_seeds, run_cells
from swarm_envs.training.reproduce.studies.lag import (
    VARIANTS,
    WANTED_RATIO,
    format_lag,
    reproduce_lag,
)


def test_variants_differ_in_what_they_say_alone():
    configs = {(v.gains, v.oracle, v.lag): v.controller for v in VARIANTS}
    assert len(configs) == 12
    on, off = configs["mid", True, True], configs["mid", True, False]
    assert on.feedforward is not None
    assert (on.lag_compensation, off.lag_compensation) == (True, False)
    assert on.gains == off.gains == configs["mid", False, True].gains
    assert configs["mid", False, True].feedforward is None


def test_lag_compensation_cuts_the_compensated_error_to_a_quarter(tmp_path):
    summary = reproduce_lag(tmp_path, seed=3, episodes=4, progress=False)
    assert set(summary["reductions"]["exact"]) == {"soft", "mid", "stiff"}
    assert min(summary["reductions"]["exact"].values()) >= WANTED_RATIO
    assert all(1.05 < ratio < 1.4 for ratio in summary["reductions"]["none"].values())
    median = {(r["gains"], r["force"], r["lag"]): r["median_cm"] for r in summary["rows"]}
    for force in ("exact", "none"):
        soft, mid, stiff = (median[g, force, "not compensated"] for g in ("soft", "mid", "stiff"))
        assert soft > mid > stiff
    assert not any(row["crashed"] for row in summary["rows"])
    with (tmp_path / "lag.csv").open(newline="") as file:
        assert [row["gains"] for row in csv.DictReader(file)][:4] == ["soft"] * 4
    assert (tmp_path / "lag.png").stat().st_size > 20_000
    said = format_lag(summary)
    assert f"{summary['reductions']['exact']['mid']:.1f}" in said
    again = reproduce_lag(tmp_path, seed=3, episodes=4, progress=False)
    assert again == summary
    with pytest.raises(ValueError, match="made with other seed"):
        reproduce_lag(tmp_path, seed=4, episodes=4, progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_the_claim_on_twenty_swaps(engine, tmp_path):
    if engine == "bullet":
        pytest.importorskip("pybullet")
    summary = reproduce_lag(tmp_path, episodes=20, engine=engine, progress=False)
    assert min(summary["reductions"]["exact"].values()) >= 20.0


def test_an_interrupted_study_goes_on(tmp_path):
    path = tmp_path / "cells.json"
    made: list[str] = []

    def compute(name):
        def cell():
            if name == "b" and not path.exists():
                raise AssertionError("b before a")
            if name == "c" and made.count("b") == 1 and made.count("stop") == 0:
                made.append("stop")
                raise KeyboardInterrupt
            made.append(name)
            return {"value": len(made)}

        return cell

    jobs = {name: compute(name) for name in "abc"}
    with pytest.raises(KeyboardInterrupt):
        run_cells(path, {"seed": 0}, jobs, progress=False)
    assert set(json.loads(path.read_text())["cells"]) == {"a", "b"}
    found = run_cells(path, {"seed": 0}, jobs, progress=False)
    assert made == ["a", "b", "stop", "c"]
    assert list(found) == ["a", "b", "c"]
    with pytest.raises(ValueError, match="made with other seed"):
        run_cells(path, {"seed": 1}, jobs, progress=False)
    path.write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        run_cells(path, {"seed": 0}, jobs, progress=False)


def test_bad_numbers_are_refused(tmp_path):
    assert draw_seeds(0, 3) == draw_seeds(0, 4)[:3]
    with pytest.raises(ValueError, match="seed is -1"):
        draw_seeds(-1, 3)
    with pytest.raises(ValueError, match="flights is 0"):
        draw_seeds(0, 0)
    with pytest.raises(ValueError, match="no row"):
        write_table(tmp_path / "empty.csv", [])
