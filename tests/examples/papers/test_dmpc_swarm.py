"""DMPC-Swarm's scripts: formations and flights, and the numbers that every command writes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from examples.papers.dmpc_swarm import figures, hall
from examples.papers.dmpc_swarm.__main__ import COMMANDS, main
from examples.papers.dmpc_swarm.flights import CRASH_M, fly_references, median_total
from swarm_envs.baselines.mlr_dmpc import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances

CASES = {
    "figure-3b": ["1 CU", "2 CUs", "3 CUs", "1 CU, ours", "2 CUs, ours", "3 CUs, ours"],
    "figure-3c": ["RR", "DT", "HT", "RR, ours", "DT, ours", "HT, ours"],
    "figure-4": ["jam, ours", "jam, paper's", "jam, none"],
}
COMMON = [command for command in COMMANDS if command != "hall"]


def test_formations_fit_the_box_and_keep_their_distance():
    config = MlrDmpcConfig()
    for name in SEQUENCE:
        places = formation(name)
        assert (places >= config.box[0]).all() and (places <= config.box[1]).all()
        assert scaled_distances(places, config).min() > config.distance_m


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
    given_up = fly_references(starts, [there], 1.0, config, compute_units=2)
    assert given_up.total_s is None and given_up.legs_s == []


def test_medians_count_flights_that_do_not_arrive():
    assert median_total({"total_s": [3.0, None, 1.0]}) == 3.0
    assert median_total({"total_s": [3.0, None]}) == 3.0
    assert math.isnan(median_total({"total_s": [None, None, 1.0]}))


@pytest.mark.parametrize("command", COMMON)
def test_each_command_writes_its_numbers(command, tmp_path, capsys):
    few = ["--drones", "3"] + (["--seeds", "1"] if command != "figure-3a" else [])
    main([command, *few, "--out", str(tmp_path)])
    name = command.replace("-", "_")
    numbers = json.loads((tmp_path / f"{name}.json").read_text())
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    for row in numbers["comparison"]:
        assert f"| {row['quantity']} | {row['paper']} | " in printed
    if command == "figure-3a":
        assert list(numbers["formations"]) == ["plane", "pyramid", "cube", "sphere"]
        assert all(len(f["places_m"]) == 3 for f in numbers["formations"].values())
        return
    cases = numbers["cases"]
    assert list(cases) == CASES[command]
    for case in cases.values():
        assert len(case["total_s"]) == 1
        assert case["arrived"] == sum(total is not None for total in case["total_s"])
        assert case["crashes"] == sum(d < CRASH_M for d in case["least_scaled_distance_m"])
        for total, legs in zip(case["total_s"], case["legs_s"], strict=True):
            assert total is None or sum(legs) == pytest.approx(total)


def test_figure_4_shows_that_recovery_keeps_drones_apart(tmp_path):
    main(["figure-4", "--drones", "10", "--seeds", "1", "--out", str(tmp_path)])
    cases = json.loads((tmp_path / "figure_4.json").read_text())["cases"]
    for name in ("jam, ours", "jam, paper's"):
        assert cases[name]["arrived"] == 1
        assert cases[name]["least_scaled_distance_m"][0] > 0.24


def test_a_distance_outside_is_explained_only_in_its_direction():
    known = {
        least: figures.distance_row("all", {"least_scaled_distance_m": [least, 0.3]}).difference
        for least in (0.2495, 0.245, 0.2)
    }
    assert known[0.2495] == "agrees" and known[0.2] == "differs, unexplained"
    assert known[0.245].startswith("differs: distances are kept at samples")


@pytest.mark.parametrize(("option", "least"), [("seeds", 1), ("seed", 0), ("drones", 2)])
def test_options_that_cannot_be_are_refused(option, least, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["figure-3b", f"--{option}", str(least - 1), "--out", str(tmp_path)])
    said = f"--{option} is {least - 1}, but must be an integer of at least {least}"
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_circle_is_flown_in_the_hall_and_errors_are_those_of_drones():
    config = MlrDmpcConfig()
    found = hall.fly("circle", 4, 0, config=config)
    assert found["time_s"] is not None and found["time_s"] < 15.0 and not found["contact"]
    assert 0.01 < found["error_m"] < 0.2  # noise and wakes, which references do not have
    assert found["least_scaled_m"] > config.distance_m - 2.0 * found["error_m"]


@pytest.mark.slow
def test_the_hall_writes_its_cases(tmp_path, capsys):
    main(["hall", "--drones", "4", "--seeds", "1", "--out", str(tmp_path)])
    numbers = json.loads((tmp_path / "hall.json").read_text())
    assert len(numbers["cases"]) == 15 and len(numbers["distances"]) == len(hall.DISTANCES_M)
    assert all(case["flights"] == 1 for case in numbers["cases"].values())
    assert "| 4, none |" in capsys.readouterr().out


def test_distances_of_26_count_both_errors():
    def case(arrived, errors):
        return {"arrived": arrived, "flights": 2, "errors_m": errors}

    jams = {f"4, {name}": case(n, [0.1, 0.1]) for name, n in
            (("ours", 2), ("paper's", 2), ("none", 0))}  # fmt: skip
    kept = {"0.25": case(2, [0.05, 0.07]), "0.16": case(2, [0.3, 0.3]), "0.12": case(1, [0.3, 0.3])}
    rows = {row.quantity: row for row in hall.compare({"cases": jams, "distances": kept})}
    error, asked, least = list(rows.values())[3:]
    assert error.result == pytest.approx(0.06) and error.spread == (0.05, 0.07)
    assert asked.result == pytest.approx(0.12 + 2.0 * 0.06) and asked.difference == "agrees"
    assert least.result == 0.16 and least.difference.startswith("differs: the hall is kinder")
