"""Figures of RTH3D and DMPC-Swarm, and Table I: what is run, measured, claimed and identified."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.rth3d import PlanNotFound, make_instance, plan
from swarm_envs.training.reproduce import dmpc_figures, dmpc_flights, rth3d_runs
from swarm_envs.training.reproduce.dmpc_flights import fly_references
from swarm_envs.training.reproduce.identified_vehicles import (
    fit_polynomial,
    mass_and_thrust,
    motor_rate,
)
from swarm_envs.training.reproduce.rth3d_letters import snapshots
from swarm_envs.training.reproduce.rth3d_runs import (
    FIGURES,
    GridSetting,
    gather_runs,
    growth,
    slabs,
)
from swarm_envs.vehicles import GRAM_FORCE, SMALL
from tests.helpers.papers import run_quietly


def settings_of(figure: str) -> set[GridSetting]:
    return {setting for curve in FIGURES[figure].series.values() for setting in curve}


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


@pytest.mark.parametrize("power", [1.5, 2.0])
def test_growth_is_the_exponent_of_the_time(power):
    solved = {"solved": True, "robots": 9, "lower_bound": 10, "winner": "rth3d", "valid": True}
    made = [
        gather_runs(
            setting,
            "rth3d-lba",
            [solved | {"cpu_s": setting.vertices**power, "makespan": 9, "before_compaction": 9}],
        )
        for setting in slabs("uniform")
    ]
    law = growth(made)
    assert law is not None and law.exponent == pytest.approx(power)
    assert growth(made[:3]) is None  # too small to be told from the cost of calls


def test_formations_fit_the_box_and_keep_their_distance():
    config = MlrDmpcConfig()
    for name in SEQUENCE:
        places = formation(name)
        assert (places >= config.box[0]).all() and (places <= config.box[1]).all()
        assert scaled_distances(places, config).min() > config.distance_m


def test_figure_4_shows_that_recovery_keeps_drones_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(dmpc_flights, "DRONES", 10)
    asked = {"figure": "4", "seeds": 1, "replay": False, "out": tmp_path}
    found = run_quietly("dmpc-swarm", **asked)[0]["cells"]
    for name in ("jam, ours", "jam, paper's"):
        assert found[name]["arrived"] == 1
        assert found[name]["least_scaled_distance_m"][0] > 0.24


def test_a_flight_is_a_sequence_of_arrivals():
    config = MlrDmpcConfig()
    starts = np.array([[-0.5, 0.0, 1.0], [0.5, 0.0, 1.0]])
    there = starts + np.array([0.0, 0.6, 0.0])
    flight = fly_references(starts, [there, starts], 20.0, config, compute_units=2)
    assert flight.total_s is not None and len(flight.legs_s) == 2
    assert sum(flight.legs_s) == pytest.approx(flight.total_s)
    k = int(np.searchsorted(flight.time, flight.arrivals_s[0] - 1e-9))
    assert np.linalg.norm(flight.position[k] - there, axis=1).max() <= config.arrival_m
    assert flight.scaled_distance.min() == pytest.approx(1.0, abs=0.2)


def test_replay_pages_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(dmpc_flights, "DRONES", 4)
    monkeypatch.setattr(dmpc_figures, "MODES", {"ours": True})
    run_quietly("dmpc-swarm", figure="4", seeds=1, out=tmp_path)
    (page,) = tmp_path.glob("*.html")
    assert "mlr-dmpc" in page.read_text()


def test_another_vehicle_is_recognised_by_how_it_moves():
    vehicle = replace(SMALL, mass=0.041, max_thrust=77 * GRAM_FORCE, motor_rate=23.0)
    mass, thrust = mass_and_thrust(vehicle)
    assert mass == pytest.approx(41.0, rel=1e-6)
    assert thrust == pytest.approx(77.0, rel=1e-6)
    assert motor_rate(vehicle) == pytest.approx(23.0, rel=1e-6)


def test_a_polynomial_is_found_with_its_errors():
    rng = np.random.default_rng(3)
    x, v = rng.uniform(0.3, 1.0, (2, 4000))
    wanted = np.array([11.0, -39.0, -9.5, 20.6, 38.4])
    exact = wanted @ [np.ones_like(x), x, v, x * x, x * v]
    found, error = fit_polynomial(exact, x, v)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert error.max() < 1e-8
    misses = []
    for _ in range(40):
        found, error = fit_polynomial(exact + rng.normal(0.0, 0.1, len(x)), x, v)
        misses.append((found - wanted) / error)
    assert 0.8 < np.std(misses) < 1.2  # standard errors are what estimates scatter by


def test_letters_stand_before_goals_change():
    goal = np.zeros((7, 2, 3))
    goal[3:, 0, 0], goal[5:, 1, 2] = 1.0, 2.0
    recording = SimpleNamespace(goal=goal, time=np.arange(7.0))
    assert snapshots(recording) == [0, 2, 4, 6]  # type: ignore[arg-type]
