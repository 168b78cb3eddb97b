"""`swarm-envs reproduce rth3d`: what it runs, keeps, fits, claims and refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import PlanNotFound, make_instance, plan
from swarm_envs.training.reproduce import rth3d_runs
from swarm_envs.training.reproduce.rth3d_figures import check_curves
from swarm_envs.training.reproduce.rth3d_runs import fit_power_law, gather_runs, growth
from swarm_envs.training.reproduce.rth3d_settings import FIGURES, GridSetting, slabs


def settings_of(figure: str) -> set[GridSetting]:
    return {setting for curve in FIGURES[figure].series.values() for setting in curve}


def test_the_standard_error_is_that_of_least_squares():
    generator = np.random.default_rng(1)
    size = np.geomspace(100, 1e6, 9)
    time = size**1.3 * np.exp(generator.normal(0.0, 0.3, 9))
    law = fit_power_law(size, time)
    line, covariance = np.polyfit(np.log(size), np.log(time), 1, cov=True)
    assert (law.exponent, law.error) == pytest.approx((line[0], np.sqrt(covariance[0, 0])))


def test_settings_are_those_of_the_paper_and_its_scripts():
    largest = max(settings_of("5"), key=lambda setting: setting.vertices)
    assert (largest.grid, largest.vertices) == ("144x72x36", 373_248)
    assert {s.shape[0] // s.shape[2] for s in settings_of("5") | settings_of("7")} == {4}
    assert {s.grid for s in settings_of("8")} == {"120x60x6"}
    assert {s.shape[2] for s in settings_of("6")} == {6}
    for figure in FIGURES:
        for setting in settings_of(figure):
            if setting.vertices < 20_000:
                made = make_instance(setting.family, setting.shape, setting.robots, seed=0)
                assert len(made.starts) * (9 / 2 if "buildings" in setting.family else 3) <= (
                    setting.vertices
                )


def test_a_run_is_that_of_the_planner():
    setting = GridSetting("quasi-buildings", (12, 6, 3))
    cell = rth3d_runs.measure_run(setting, "rth3d-lba", 5)
    made = make_instance(setting.family, setting.shape, seed=5)
    found = plan(made.starts, made.goals, made.shape, made.obstacles, method="rth3d-lba", seed=5)
    assert found.before_compaction is not None
    assert cell["makespan"] == found.makespan
    assert cell["before_compaction"] == found.before_compaction
    assert cell["bound"] == setting.length + 9 + cell["balancing_steps"]
    point = gather_runs(setting, "rth3d-lba", [cell])
    assert point.ratio is not None and point.ratio.mean == pytest.approx(found.ratio)
    assert point.constant == found.before_compaction - (12 + 2 * 6 + 2 * 3)


def test_a_failure_is_counted(monkeypatch):
    def give_up(*arguments: object, **options: object) -> None:
        raise PlanNotFound("none")

    rth3d_runs.warm_up()
    monkeypatch.setattr(rth3d_runs, "plan", give_up)
    setting = GridSetting("rings", (12, 12, 6))
    point = gather_runs(setting, "pibt", [rth3d_runs.measure_run(setting, "pibt", 0)])
    assert (point.runs, point.solved, point.ratio) == (1, 0, None)


def test_there_are_fewer_runs_where_grids_are_large():
    small, large = slabs("uniform")[0], slabs("uniform")[-1]
    assert rth3d_runs.runs_at(small, 20, 250_000) == 20
    assert rth3d_runs.runs_at(large, 20, 250_000) == 1
    assert rth3d_runs.runs_at(large, 20, 3 * large.vertices) == 3
    assert rth3d_runs.runs_at(GridSetting("rings", (12, 12, 6)), 20, 250_000) == 1


def test_claims_can_fail():
    row = slabs("uniform")
    figure = replace(FIGURES["5"], series={"uniform": row})
    exact = {"solved": True, "robots": 9, "lower_bound": 10, "winner": "rth3d", "valid": True}

    def held(time_power: float, step: int, excess: int) -> list[bool]:
        made = []
        for k, setting in enumerate(row):
            took = {"cpu_s": setting.vertices**time_power, "makespan": 40 + step * k}
            before = {"before_compaction": setting.length + excess}
            made.append(gather_runs(setting, "rth3d-lba", [exact | took | before]))
        law = growth(made)
        assert law is not None and law.exponent == pytest.approx(time_power)
        return [claim["holds"] for claim in check_curves(figure, {("uniform", "rth3d-lba"): made})]

    # paper's ratio, ours, the bound, falling ratios, order of the time
    assert held(2.0, 1, 31) == [False, False, False, False, False]
    assert held(1.5, -3, 30) == [False, True, True, True, True]
