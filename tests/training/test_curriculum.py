"""The curriculum: next rounds, what is measured, resumption; explained variance of its beliefs."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.training.collection.collect import FlightBatch, flight_generator, make_motion
from swarm_envs.training.collection.log import FlightLog
from swarm_envs.training.collection.table import CollectedFlight as Flight
from swarm_envs.training.curriculum import CurriculumConfig
from swarm_envs.training.curriculum import run as run_module
from swarm_envs.training.curriculum.curriculum_config import Stage, collection_config
from swarm_envs.training.curriculum.curriculum_report import (
    evaluate_unseen,
    goals_reached,
    horizontal_share,
    rounds_table,
    sizes_as_json,
)
from swarm_envs.training.curriculum.run import (
    Closeness,
    curriculum_command,
    measure_closeness,
    next_clearance,
    run_curriculum,
)
from swarm_envs.training.force_model.explained import (
    explained_variance,
    generalisation,
    random_states,
)
from swarm_envs.training.provenance import json_ready
from swarm_envs.vehicles import SMALL, parse_team
from tests.helpers.interrupts import calls_of
from tests.training.test_controller_studies import planted

CALM = Closeness(0.04, 0.1, 1.5, 10, 100.0, 0, 0)
TINY = CurriculumConfig(
    out=Path("replaced"),
    flights=2,
    duration_s=3.0,
    steps=30,
    last_steps=40,
    episodes=1,
    stages=(Stage("alone and in pairs", ("S", "L", "SL"), False), Stage("pairs", ("SL",), True)),
    unseen_teams=("LS", "SSL", "SSSSL"),
    progress=False,
)


@pytest.mark.parametrize(
    ("clearance", "closeness", "unknown", "expected"),
    [
        (0.30, CALM, 1.0, 0.09),  # 0.3 is all that it dares at once: 1.5 * 4 cm would do
        (0.10, CALM, 1.0, 0.06),  # 1.5 times the gap error
        (0.10, CALM, 0.9, 0.054),  # of which a tenth is known by now
        (0.10, CALM, 2.0, 0.06),  # a model that got worse promises nothing
        (0.02, dataclasses.replace(CALM, gap_error_m=0.0), 1.0, 0.015),
        (0.20, dataclasses.replace(CALM, cut_swaps=1), 1.0, 0.20),  # a contact: no closer
    ],
)
def test_the_next_round_plans_by_the_rule(clearance, closeness, unknown, expected):
    assert next_clearance(clearance, closeness, unknown, 1.5, 0.015) == pytest.approx(expected)


def synthetic(name, gaps, planned, lateral, team="SS"):
    """Two drones over each other at given gaps, set-points at given gaps."""
    count = len(gaps)
    position, setpoint = np.zeros((2, count, 2, 3))
    position[:, 1, 2], position[:, 1, 0], setpoint[:, 1, 2] = gaps, lateral, planned
    nothing = np.zeros((count, 2, 3))
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (count, 2, 1))
    log = FlightLog(position, nothing, quaternion, nothing, setpoint, np.zeros((count, 2, 4)))
    return Flight(name, team, log, False)


def test_closeness_is_measured_where_drones_pass():
    count = 120
    gaps = np.full(count, 0.30)
    gaps[50], gaps[60], gaps[5] = 0.25, 0.33, 0.18
    lateral = np.full(count, 0.05)
    lateral[5] = 0.5  # far to the side: no passing
    flights = [
        synthetic("SS-swap-000", gaps, 0.30, lateral),
        synthetic("SS-walk-000", np.full(60, 0.20), 0.20, 0.0),  # a walk, cut short
    ]
    found = measure_closeness(flights, duration_s=1.0)
    assert found.gap_error_m == pytest.approx(0.05)
    assert found.least_clearance_m == pytest.approx(0.25 - 2 * SMALL.radius)
    assert found.least_distance_ratio == pytest.approx(0.20 / (2 * SMALL.radius), abs=1e-3)
    assert (found.cut_swaps, found.cut_walks, found.flights) == (0, 1, 2)


def test_gap_errors_are_a_quantile_of_the_swaps():
    flights = [
        synthetic(f"SS-swap-{k:03d}", np.full(120, 0.3 - 0.001 * k), 0.3, 0.0) for k in range(21)
    ]
    assert measure_closeness(flights, 1.0).gap_error_m == pytest.approx(0.019)


def test_swaps_keep_the_clearance_that_was_planned():
    for clearance in (0.25, 0.02):
        config = collection_config(TINY, 1, clearance, None)
        for kind in ("swap", "low-swap"):
            batch = FlightBatch("SL", kind, 30)
            rngs = [flight_generator(config, name) for name in batch.names]
            heights = make_motion(config, batch, rngs).start[..., 2]
            between = np.abs(heights[:, 1] - heights[:, 0]) - 0.155
            assert between.min() >= clearance - 1e-9
            assert between.min() < clearance + 0.1
            assert heights.min() - 0.06 >= clearance


def contents(folder):
    names = ("*.safetensors", "rows.npz", "unseen.json", "manifest.json", "*.png")
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for name in names
        for file in folder.rglob(name)
    }


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    out = tmp_path_factory.mktemp("curriculum")
    return out, run_curriculum(dataclasses.replace(TINY, out=out))


def test_a_run_reports_every_round(tiny):
    out, report = tiny
    said = json.loads((out / "curriculum.json").read_text())
    assert [r["compensated"] for r in said["rounds"]] == [False, True]
    assert said["rounds"][1]["clearance_m"] == said["rounds"][0]["next_clearance_m"]
    assert said["rounds"][1]["rows"] > said["rounds"][0]["rows"] > 300
    manifest = json.loads((out / "round_2" / "flights" / "manifest.json").read_text())
    assert manifest["feedforward_sha256"] is not None
    assert {u["drones"]: len(u["explained"]) for u in said["unseen"]} == {2: 2, 3: 2, 5: 2}
    assert set(said["explained"]) == {"2", "3", "5"}
    assert str(out) not in json.dumps(said)
    weights = (out / "round_2" / "fit" / "learned.safetensors").read_bytes()
    assert (out / "learned.safetensors").read_bytes() == weights
    text = "\n".join(report.lines())
    assert "1 alone and in pairs" in text and "5 drones: " in text
    assert (out / "curriculum.png").read_bytes().startswith(b"\x89PNG")


def test_killed_at_every_stage_it_goes_on_and_ends_the_same(tiny, tmp_path):
    config = dataclasses.replace(TINY, out=tmp_path)
    # In the second round, after its flights; after its fit; at the end.
    for name, call in (("fit", 2), ("measure_closeness", 1), ("evaluate_unseen", 2)):
        with calls_of(run_module, name, killed_at=call), pytest.raises(KeyboardInterrupt):
            run_curriculum(config)
    assert not (tmp_path / "curriculum.json").exists()
    run_curriculum(config)
    assert contents(tmp_path) == contents(tiny[0])


def test_a_round_in_which_nobody_passed_is_read_as_it_was_written(tiny, tmp_path):
    first = tiny[1]["rounds"][0]
    unknown = dataclasses.replace(first["closeness"], least_clearance_m=float("nan"))
    report = first | {"closeness": unknown}
    write_json(tmp_path / "round.json", json_ready(report))
    again = run_module.read_round(tmp_path / "round.json")
    assert np.isnan(again["closeness"].least_clearance_m)
    assert rounds_table([again], []) == rounds_table([report], [])


def test_a_folder_of_another_curriculum_is_refused(tiny):
    out, _ = tiny
    with pytest.raises(ValueError, match=r"options: config.seed is 0 there, 1 here; choose"):
        run_curriculum(dataclasses.replace(TINY, out=out, seed=1))


def test_a_model_that_is_the_truth_explains_all_and_none_nothing():
    truth = load("learned")
    found = evaluate_unseen([load("none"), truth], truth, "SS", 1)
    assert found["explained"][1] == found["explained_horizontal"][1] == 1.0
    assert found["explained"][0] < 0.1 and found["rms_error_g"] == 0.0
    assert found["crashed"] == 0 and found["rms_force_g"] > 0.5


def test_horizontal_share_by_hand():
    true = np.zeros((2, 1, 3))
    true[:, 0, 0] = 1.0, -1.0
    found = true.copy()
    found[:, 0, 0] *= 0.5
    assert horizontal_share(found, true) == pytest.approx(0.75)
    assert horizontal_share(true, np.zeros((2, 1, 3))) == 0.0


def test_goals_are_of_the_worst_team_of_each_size():
    def unseen(team, value):
        return {"team": team, "drones": len(team), "explained": [0.0, value]}

    good = [unseen("SS", 0.9), unseen("SSS", 0.86), unseen("SSSSS", 0.71)]
    assert goals_reached(good)
    assert not goals_reached([*good, unseen("LL", 0.84)])
    sizes = sizes_as_json([*good, unseen("LL", 0.84)])
    assert sizes["2"] == {"mean": 0.87, "least": 0.84, "goal": 0.85}
    assert sizes["5"]["goal"] == 0.70


def test_the_command_names_what_differs_from_the_default():
    text = curriculum_command(dataclasses.replace(TINY, seed=3))
    assert text.startswith("swarm-envs curriculum --out DIR --seed 3")
    assert "--flights 2" in text and "--last-steps 40" in text and "stages" not in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--margin 0.5", "margin is 0.5"),
        ("--flights 1", "flights is 1"),
        ("--interactions none", "there is no force to learn"),
        ("--quick --flights 3 --steps 50", "quick sets flights, steps itself"),
    ],
)
def test_bad_options_are_refused_with_exit_code_2(words, said, tmp_path, refused):
    assert said in refused("curriculum", "--out", tmp_path / "out", *words.split())
    assert not (tmp_path / "out").exists()


def test_the_small_curriculum_is_of_a_set_size(tmp_path):
    small = CurriculumConfig(out=tmp_path, seed=2, quick=True).sized()
    assert (small.flights, small.duration_s, small.steps, small.last_steps) == (2, 6.0, 300, 800)
    assert (small.seed, small.episodes) == (2, 4) and small.sized() == small


@pytest.mark.slow
def test_the_curriculum_explains_the_true_force(tmp_path):
    """Half of the time in flight and of the steps of the command's defaults."""
    config = CurriculumConfig(
        out=tmp_path, flights=3, duration_s=8.0, steps=800, last_steps=2000, episodes=4
    )
    report = run_curriculum(config)
    for size, least in (("2", 0.85), ("3", 0.85), ("5", 0.70)):
        assert report["explained"][size]["mean"] > least, size
    first, second, *_, last = report["rounds"]
    assert second["closeness"].gap_error_m < 0.8 * first["closeness"].gap_error_m
    assert last["clearance_m"] < 0.6 * first["clearance_m"]


def test_the_truth_explains_itself_and_nothing_explains_less_than_nothing():
    position, velocity = random_states("SSL", 50, np.random.default_rng(0))
    wake = load("wake")
    assert explained_variance(wake, wake, position, velocity, "SSL") == 1.0
    force = wake.forces(position, velocity, "SSL")[..., 2]
    expected = 1.0 - np.mean(force**2) / force.var()
    got = explained_variance(load("none"), wake, position, velocity, "SSL")
    assert got == pytest.approx(expected) and got < 0.0


def test_generalisation_says_each_team():
    teams = ("SS", "SSSSS", "S" * 16)
    found = generalisation(planted(0.9), load("wake"), teams, seed=3, states=30)
    assert [e["drones"] for e in found] == [2, 5, 16]
    near = [e["mean_neighbours"] for e in found]
    assert near[0] < near[1] < near[2]
    for e in found:
        assert e["rms_error_g"] == pytest.approx(0.1 * e["rms_force_g"])
        assert 0.9 < e["explained"] < 1.0
    assert found[1:] == generalisation(planted(0.9), load("wake"), teams[1:], seed=3, states=30)


def test_random_states_are_close_but_do_not_touch():
    team = "SSLS*"
    position, velocity = random_states(team, 200, np.random.default_rng(2))
    radius = np.array([vehicle.radius for vehicle in parse_team(team)])
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    apart[:, range(4), range(4)] = np.inf
    assert (apart > radius[:, None] + radius).all()
    assert (apart.min(axis=(1, 2)) < 0.7).all()
    lowest = position[..., 2].min(axis=1)
    assert lowest.min() >= 0.3 and lowest.max() <= 0.8
    assert np.quantile(np.linalg.norm(velocity, axis=-1), 0.99) < 1.0


def test_a_truth_that_never_blows_is_refused():
    position, velocity = random_states("SS", 5, np.random.default_rng(0))
    with pytest.raises(ValueError, match="must vary; give states"):
        explained_variance(load("wake"), load("none"), position, velocity, "SS")
