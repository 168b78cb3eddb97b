"""`swarm-envs reproduce dmpc-swarm`: what it flies, writes, keeps and refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.cli import main
from swarm_envs.training.reproduce import dmpc_figures, dmpc_flights
from swarm_envs.training.reproduce.dmpc_flights import SwarmSetup, fly_references

COMMAND = ["reproduce", "dmpc-swarm"]


def test_formations_fit_the_box_and_keep_their_distance():
    config = MlrDmpcConfig()
    for name in SEQUENCE:
        places = formation(name)
        assert (places >= config.box[0]).all() and (places <= config.box[1]).all()
        assert scaled_distances(places, config).min() > config.distance_m


def test_figure_4_shows_that_recovery_keeps_drones_apart(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(dmpc_flights, "DRONES", 10)
    out = tmp_path / "figures"
    command = [*COMMAND, "--figure", "4", "--seeds", "1", "--out", str(out), "--no-replay"]
    assert main(command) == 0
    found = json.loads((out / "figure_4.json").read_text())["cells"]
    for name in ("jam, ours", "jam, paper's"):
        assert found[name]["arrived"] == 1
        assert found[name]["least_scaled_distance_m"][0] > 0.24
    shown = capsys.readouterr().out
    assert all(name in shown for name in found)
    assert {path.suffix for path in out.glob("[!.]*")} == {".json", ".csv", ".png"}


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
    assert main([*COMMAND, "--figure", "4", "--seeds", "1", "--out", str(tmp_path)]) == 0
    (page,) = tmp_path.glob("*.html")
    assert "mlr-dmpc" in page.read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "give one of"),
        (["--figure", "4", "--study", "loss"], "give one of"),
        (["--figure", "4", "--seeds", "0"], "must be"),
        (["--figure", "5"], "invalid choice"),
    ],
)
def test_bad_options_are_refused(options, said, capsys):
    with pytest.raises(SystemExit) as end:
        main([*COMMAND, *options])
    assert end.value.code == 2
    shown = capsys.readouterr()
    assert said.split()[0] in (shown.err + shown.out)
