"""The model that is fed forward: what ships compensates, is zero alone, and can be made again."""

import dataclasses
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.agent import BELIEFS
from swarm_envs.baselines.neural_swarm.flights import PAPER_SWAP
from swarm_envs.interactions import load
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.belief import (
    FeedforwardConfig,
    SwapTrial,
    compare_compensation,
    feedforward_command,
    fit_feedforward,
)
from swarm_envs.training.collection import CollectionConfig, interaction_rows
from swarm_envs.training.collection.collect import collect
from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.interaction_rows.modelled import modelled_force_g

WEIGHTS = Path(str(resources.files("swarm_envs.baselines.neural_swarm") / "weights"))
FRESH = CollectionConfig(
    teams=("SL", "LL", "SSS"), walks=2, low_walks=2, swaps=2, low_swaps=2, duration_s=6.0, seed=977
)


LABEL_NOISE = {"S": 0.13, "L": 0.5}
"""Of the labels of lone drones, whose force is next to nothing, g^2: no model can do better."""
every_truth = pytest.mark.parametrize("truth", BELIEFS)


@every_truth
def test_what_ships_predicts_fresh_flights(tmp_path, truth):
    fresh = dataclasses.replace(FRESH, interactions=truth)
    rows = interaction_rows(collect(fresh, tmp_path, progress=False))
    rows = dataclasses.replace(rows, validation=np.ones(len(rows), dtype=np.bool_))
    weights = str(WEIGHTS / f"{BELIEFS[truth]}.safetensors")
    errors = mean_squared_errors(modelled_force_g(rows, weights)[:, 2], rows)
    assert errors.overall < errors.zero / 30
    # Noise is the larger for S2L alone, where the force is about 1.5 g.
    for name, error in errors.scenario.items():
        assert error < max(errors.scenario_zero[name] / 10, 1.5 * LABEL_NOISE[name[-1]]), name


@pytest.mark.parametrize("apart", [[0.35, 0.0, 0.3], [0.0, -0.4, 0.1], [0.0, 0.0, 1.1]])
@every_truth
def test_what_ships_believes_nothing_where_no_neighbour_is_near(apart, truth):
    position = np.array([[[0.1, 0.2, 0.8], np.add([0.1, 0.2, 0.8], apart)]])
    for team in ("SS", "SL", "LS"):
        force = load_belief(truth).forces(position, np.zeros((1, 2, 3)), team)
        assert (force == 0.0).all()


@every_truth
def test_what_ships_was_fitted_in_the_environment_that_ships(truth):
    report = json.loads((WEIGHTS / f"{BELIEFS[truth]}.json").read_text())
    assert report["interactions_sha256"] == load(truth).fingerprint, (
        "the environment's force model has changed since; make the belief again: "
        + report["command"]
    )
    assert load_belief(truth).notes["command"] == report["command"]
    cards = (WEIGHTS / "MODEL_CARD.md").read_text().split("# `")
    card = next(card for card in cards if card.startswith(f"{BELIEFS[truth]}.safetensors`"))
    assert f"the force model `{truth}`" in card
    assert report["command"] in card and str(report["rows"]) in card and "simulated" in card


@pytest.mark.parametrize("team", ["S2S", "L2S", "SS2S"])
def test_compensation_leaves_a_tenth_of_the_error_and_harms_nobody(team):
    result = compare_compensation(SwapTrial(team, PAPER_SWAP, 6), load_belief())
    assert result.uncompensated_median_cm > 5.0
    assert result.compensated_median_cm < 0.1 * result.uncompensated_median_cm
    assert result.worse == 0 and result.largest_ratio < 0.15
    assert result.upper_largest_growth_cm < 0.5


def test_a_model_of_a_force_that_is_not_there_is_found_out():
    trial = SwapTrial("L2S", PAPER_SWAP, 2)
    result = compare_compensation(trial, load("learned"), environment="none")
    assert result.worse == 2 and result.largest_ratio > 2.0


@pytest.mark.slow
def test_compensation_in_every_layout_of_every_team():
    for team in ("S2S", "L2S", "SS2S", "S2L", "L2L", "SL2S", "LL2S", "SS2L", "SL2L", "LL2L"):
        result = compare_compensation(SwapTrial(team, StackedLayout(), 30), load_belief())
        assert result.worse == 0, team
        assert result.compensated_median_cm < 0.3 * result.uncompensated_median_cm, team


FEW = CollectionConfig(("S", "L", "SL"), walks=2, low_walks=0, swaps=2, low_swaps=0, duration_s=4.0)
TRIALS = (SwapTrial("L2S", PAPER_SWAP, 1),)
TINY = FeedforwardConfig(Path(), seed=3, steps=40, collection=FEW, progress=False, trials=TRIALS)


def test_a_belief_is_made_twice_the_same_and_says_from_what(tmp_path):
    reports = [fit_feedforward(dataclasses.replace(TINY, out=tmp_path / name)) for name in "ab"]
    one, two = ((tmp_path / name / "belief.safetensors").read_bytes() for name in "ab")
    assert one == two
    report = json.loads((tmp_path / "a" / "belief.json").read_text())
    assert report["interactions"] == "learned" and report["flights"] == 8
    assert report["rows"] == reports[0]["rows"] > 100
    assert (report["flown_s"], report["trials"][0]["team"]) == (reports[1]["flown_s"], "L2S")
    model = load(tmp_path / "a" / "belief.safetensors")
    alone = model.forces(np.array([[[0.0, 0.0, 1.0]]]), np.zeros((1, 1, 3)), "S")
    assert (alone == 0.0).all() and model.types == ("S", "L")
    assert str(tmp_path) not in (tmp_path / "a" / "belief.json").read_text()


def test_the_command_names_what_differs_from_the_default():
    text = feedforward_command(TINY)
    assert "--seed 3 --steps 40" in text and "--collection.teams S L SL" in text
    assert "motion" not in text and "collection.seed" not in text
