"""`swarm-envs reproduce dmpc-swarm`: what it flies, writes, keeps and refuses."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.training.reproduce import dmpc_figures, dmpc_flights
from swarm_envs.training.reproduce.dmpc_flights import SwarmSetup, fly_references
from tests.helpers.papers import run_quietly


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
    flight = fly_references(starts, [there, starts], SwarmSetup(compute_units=2), 20.0, config)
    assert flight.total_s is not None and len(flight.legs_s) == 2
    assert sum(flight.legs_s) == pytest.approx(flight.total_s)
    k = int(np.searchsorted(flight.time, flight.arrivals_s[0] - 1e-9))
    assert np.linalg.norm(flight.position[k] - there, axis=1).max() <= config.arrival_m
    assert flight.scaled_distance.min() == pytest.approx(1.0, abs=0.2)


def test_replay_pages_are_written(tmp_path, monkeypatch):
    pytest.importorskip("plotly")
    monkeypatch.setattr(dmpc_flights, "DRONES", 4)
    monkeypatch.setattr(dmpc_figures, "MODES", {"ours": True})
    run_quietly("dmpc-swarm", figure="4", seeds=1, out=tmp_path)
    (page,) = tmp_path.glob("*.html")
    assert "mlr-dmpc" in page.read_text()
