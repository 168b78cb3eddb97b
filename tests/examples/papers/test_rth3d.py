"""RTH3D's scripts: what is run and measured, and the numbers that every command writes."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from examples.papers.rth3d import figures, runs
from examples.papers.rth3d.__main__ import COMMANDS, main
from examples.papers.rth3d.letters import snapshots
from examples.papers.rth3d.runs import Options, Setting, gather_point, growth, measure_run
from swarm_envs.baselines.rth3d import PlanNotFound, make_instance, plan
from swarm_envs.vehicles import SMALL

TINY = {
    "figure-5": "--runs 2 --largest 2000",
    "figure-6": "--runs 1 --largest 2000",
    "figure-7": "--runs 1 --largest 2000",
    "figure-8": "--runs 1 --methods rth3d",
    "figure-9": "--runs 1 --largest 4000",
    "figure-11": "",
}
"""Options with which each command takes seconds."""


def settings_of(number):
    return {s for curve in getattr(figures, f"FIGURE_{number}").values() for s in curve}


def test_settings_are_those_of_the_paper_and_its_scripts():
    largest = max(settings_of(5), key=lambda setting: setting.vertices)
    assert (largest.grid, largest.vertices) == ("144x72x36", 373_248)
    assert {s.shape[0] // s.shape[2] for s in settings_of(5) | settings_of(7)} == {4}
    assert {s.grid for s in settings_of(8)} == {"120x60x6"}
    assert {s.shape[2] for s in settings_of(6)} == {6}
    for setting in set().union(*map(settings_of, range(5, 10))):
        if setting.vertices < 20_000:
            made = make_instance(setting.family, setting.shape, setting.robots, seed=0)
            share = 9 / 2 if "buildings" in setting.family else 3
            assert len(made.starts) * share <= setting.vertices


def test_a_run_is_that_of_the_planner():
    setting = Setting("quasi-buildings", (12, 6, 3))
    run = measure_run(setting, "rth3d-lba", 5)
    made = make_instance(setting.family, setting.shape, seed=5)
    found = plan(made.starts, made.goals, made.shape, made.obstacles, method="rth3d-lba", seed=5)
    assert found.before_compaction is not None
    assert run["makespan"] == found.makespan
    assert run["before_compaction"] == found.before_compaction
    assert run["bound"] == 12 + 2 * 6 + 2 * 3 + 9 + run["balancing_steps"]
    point = gather_point("buildings", setting, "rth3d-lba", [run])
    assert point["ratio"] == pytest.approx(found.ratio, rel=1e-3)
    assert point["most_over_m1_2m2_2m3"] == found.before_compaction - (12 + 2 * 6 + 2 * 3)


def test_a_failure_is_counted(monkeypatch):
    def give_up(*arguments, **options):
        raise PlanNotFound("none")

    runs.compile_kernels()
    monkeypatch.setattr(runs, "plan", give_up)
    setting = Setting("rings", (12, 12, 6))
    point = gather_point("rings", setting, "pibt", [measure_run(setting, "pibt", 0)])
    assert (point["runs"], point["solved"], point["ratio"]) == (1, 0, None)


def test_there_are_fewer_runs_where_grids_are_large():
    small, large = Setting("uniform", (12, 6, 3)), Setting("uniform", (144, 72, 36))
    assert len(Options().seeds(small)) == 20
    assert len(Options().seeds(large)) == 1
    assert len(Options(budget=3 * large.vertices).seeds(large)) == 3
    assert len(Options().seeds(Setting("rings", (12, 12, 6)))) == 1


@pytest.mark.parametrize("power", [1.5, 2.0])
def test_growth_is_the_exponent_of_the_time(power):
    sizes = [setting.vertices for setting in figures.FIGURE_5["uniform"]]
    points = [{"vertices": size, "cpu_s": size**power} for size in sizes]
    law = growth(points)
    assert law is not None and law["exponent"] == pytest.approx(power)
    assert growth(points[:3]) is None  # too small to be told from the cost of calls


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_writes_its_numbers(command, tmp_path, capsys):
    main([command, *TINY[command].split(), "--out", str(tmp_path)])
    name = command.replace("-", "_")
    numbers = json.loads((tmp_path / f"{name}.json").read_text())
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert numbers["comparison"] and all(
        f"| {row['quantity']} | {row['paper']} | " in printed for row in numbers["comparison"]
    )
    if command == "figure-11":
        assert numbers["letters_reached"] == 5 and numbers["collisions"] == 0
        assert numbers["success"] and len(numbers["makespans"]) == 4
        assert numbers["least_distance_m"] >= 1.5 * SMALL.diameter  # no near miss
        assert np.shape(numbers["places_m"]) == (5, 10, 3)
        return
    with (tmp_path / f"{name}.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(numbers["points"])
    for row, point in zip(rows, numbers["points"], strict=True):
        assert float(row["ratio"]) == point["ratio"] >= 1.0
        key = ("series", "grid", "method", "robots")
        own = [r for r in numbers["runs"] if all(r[k] == point[k] for k in key)]
        ratios = [run["makespan"] / run["lower_bound"] for run in own]
        assert len(own) == point["runs"] and all(run["valid"] for run in own)
        assert point["ratio"] == pytest.approx(np.mean(ratios), rel=1e-3)


def test_a_ratio_outside_is_explained_only_in_its_direction():
    point = {"series": "uniform", "grid": "144x72x36", "robots": 124_416}
    point |= {"method": "rth3d", "runs": 1}
    known = {
        ratio: figures.compare_5([{**point, figures.BEFORE: ratio}])[0].difference
        for ratio in (1.68, 1.58, 1.9)
    }
    assert known[1.68] == "agrees" and known[1.9] == "differs, unexplained"
    assert known[1.58].startswith("differs: balancing takes the fewest steps")


@pytest.mark.parametrize("methods", [("auto", "auto"), ()])
def test_methods_are_named_once(methods):
    with pytest.raises(ValueError, match="name each method once"):
        Options(methods=methods)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("figure-8 --largest 43199", "below every grid of the figure; the smallest has 43200"),
        ("figure-11 --seed -1", "--seed is -1, but must be"),
        ("figure-5 --runs 0", "--runs is 0, but must be an integer of at least 1"),
        ("figure-5 --budget 0", "--budget is 0, but must be an integer of at least 1"),
        ("figure-5 --methods rth4d", "rth3d-lba"),
    ],
)
def test_what_cannot_be_run_is_refused_and_writes_nothing(words, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main([*words.split(), "--out", str(tmp_path / "out")])
    assert end.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_letters_stand_before_goals_change():
    goal = np.zeros((7, 2, 3))
    goal[3:, 0, 0], goal[5:, 1, 2] = 1.0, 2.0
    recording = SimpleNamespace(goal=goal, time=np.arange(7.0))
    assert snapshots(recording) == [0, 2, 4, 6]  # type: ignore[arg-type]
