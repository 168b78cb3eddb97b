"""Files of a collection: Parquet as real flights log it, resumption, the command."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.training.collection import (
    CollectionConfig,
    collect,
    interaction_rows,
)
from swarm_envs.training.collection.storage import (
    commanded_thrust,
    flight_file,
    from_table,
    motor_signals,
    read_log,
    to_table,
)
from swarm_envs.training.collection.table import SCENARIOS
from swarm_envs.training.flight_logs import LogOptions, read_logs
from swarm_envs.vehicles import LARGE, SMALL, parse_team

CONFIG = CollectionConfig(
    teams=("S", "SL"), walks=2, low_walks=0, swaps=2, low_swaps=0, duration_s=6.0, label="imu"
)


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    return collect(CONFIG, tmp_path_factory.mktemp("npz"), progress=False)


def parquet(config, out):
    pytest.importorskip("pyarrow")
    return collect(dataclasses.replace(config, format="parquet"), out, progress=False)


def test_signals_are_those_that_psi1_makes_the_thrust_of():
    team = (SMALL, LARGE)
    hover = np.array([v.hover_rotor_thrust for v in team])[:, None]
    commands = hover * np.random.default_rng(0).uniform(0.6, 1.5, (600, 2, 4))
    pwm, volts = motor_signals(commands, team, 120.0)
    assert (pwm > 0.0).all() and (pwm < 65535.0).all()
    np.testing.assert_allclose(commanded_thrust(pwm, volts, team), commands, rtol=1e-9)
    assert (volts > 3.0).all() and (volts < 4.2).all()
    assert (volts[-60:].mean(axis=0) < volts[:60].mean(axis=0)).all()  # the battery empties


def test_a_thrust_beyond_the_motors_is_logged_as_the_nearest_signal():
    commands = np.array([[[0.0, 0.0, 0.0, 0.0]], [[9.0, 9.0, 9.0, 9.0]]])
    pwm, _ = motor_signals(commands, (SMALL,), 120.0)
    assert (pwm[1] == 65535.0).all() and (pwm[0] > 0.0).all()


@pytest.mark.parametrize("accelerometer", [True, False])
def test_a_table_holds_what_the_log_holds(flights, accelerometer):
    flight = next(f for f in flights if f.team == "SL")
    team = parse_team("SL")
    table = to_table(flight.log, team, 120, accelerometer)
    assert table.drone[:4].tolist() == ["S1", "L1", "S1", "L1"]
    back = from_table(table, team)
    for name in ("position", "velocity", "quaternion"):
        np.testing.assert_array_equal(getattr(back, name), getattr(flight.log, name))
    known = flight.log.commands > np.array([[0.02], [0.09]])  # psi1 gives no rotor less
    assert known.mean() > 0.95
    np.testing.assert_allclose(back.commands[known], flight.log.commands[known], atol=1e-9)
    assert np.isnan(back.setpoint).all()
    if accelerometer:
        np.testing.assert_allclose(back.specific_force, flight.log.specific_force, atol=1e-6)
    else:
        assert table.acceleration is None and np.isnan(back.specific_force).all()
    with pytest.raises(ValueError, match="must list L1, S1"):
        from_table(table, parse_team("LS"))


@pytest.mark.parametrize("label", ["imu", "differentiated"])
def test_parquet_flights_are_read_as_if_they_were_real(flights, label, tmp_path):
    flown = parquet(dataclasses.replace(CONFIG, label=label), tmp_path)
    rows, report = read_logs(tmp_path, LogOptions(guard_s=0.0, keep_every=4, rate_hz=120.0))
    assert all(file.refused is None for file in report.files)
    wanted = "logged" if label == "imu" else "differentiated"
    assert {file.acceleration for file in report.files} == {wanted}
    assert set(report.vehicles) == {"S1", "L1"}
    ours = interaction_rows(flown, label)
    for name in ("Ge2S", "L2S", "S2L"):  # the same forces by two roads
        a = rows.force_g[rows.scenario == rows.scenario_names.index(name)]
        b = ours.force_g[ours.scenario == ours.scenario_names.index(name)]
        assert len(a) == pytest.approx(len(b), rel=0.15)
        np.testing.assert_allclose(a.mean(axis=0), b.mean(axis=0), atol=0.15)
        np.testing.assert_allclose(a.std(axis=0), b.std(axis=0), rtol=0.15, atol=0.05)


@pytest.mark.parametrize("form", ["npz", "parquet"])
def test_killed_and_called_again_the_folder_is_the_same_to_the_byte(form, tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    config = dataclasses.replace(CONFIG, format=form, duration_s=1.5, log_rate=100)
    whole = tmp_path / "whole"
    collect(config, whole, progress=False)
    module = sys.modules[collect.__module__]
    saved: list[str] = []
    save = module.save_log

    def killed(*arguments):
        if len(saved) == 3:
            raise KeyboardInterrupt
        saved.append(arguments[0].name)
        save(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(module, "save_log", killed)
        with pytest.raises(KeyboardInterrupt):
            collect(config, tmp_path / "cut", progress=False)
    first = (tmp_path / "cut" / saved[0]).stat().st_mtime_ns
    collect(config, tmp_path / "cut", progress=False)
    assert (tmp_path / "cut" / saved[0]).stat().st_mtime_ns == first  # not flown again
    for file in whole.iterdir():
        assert (tmp_path / "cut" / file.name).read_bytes() == file.read_bytes()


def test_a_parquet_flight_cannot_be_read_without_its_team(tmp_path):
    with pytest.raises(ValueError, match="give the team"):
        read_log(flight_file(tmp_path, "SL-walk-000", "parquet"))


def test_the_command_covers_table_ii_and_says_so(tmp_path, capsys):
    out, numbers = tmp_path / "out", tmp_path / "numbers.json"
    words = "--duration-s 3 --walks 2 --low-walks 0 --swaps 1 --low-swaps 0 --log-rate 100"
    assert main(["collect", "--out", str(out), "--json", str(numbers), *words.split()]) == 0
    said = capsys.readouterr()
    assert "all twelve scenarios of Table II have rows" in said.out
    assert "flights: 100%" in said.err
    summary = json.loads(numbers.read_text())
    assert list(summary["scenarios"]) == list(SCENARIOS)
    assert sum(s["rows"] for s in summary["scenarios"].values()) == summary["rows"]
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["log_rate"] == 100 and manifest["config"]["noise"]["velocity"] == 0.01
    for name, scenario in manifest["scenarios"].items():
        assert summary["scenarios"][name]["flights"] == scenario["flights"] >= 1
        assert f"\n{name} " in said.out


def test_the_command_says_which_scenarios_are_missing(tmp_path, capsys):
    words = "--teams S SL --duration-s 3 --walks 1 --low-walks 0 --swaps 0 --low-swaps 0"
    assert main(["collect", "--out", str(tmp_path), *words.split(), "--no-progress"]) == 0
    assert "of Table II no row of S2S, SS2S" in capsys.readouterr().out


@pytest.mark.parametrize("words", ["--teams", "--teams S L --walks 0 --low-walks 0"])
def test_a_collection_of_no_flight_is_refused_with_exit_code_2(words, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["collect", "--out", str(tmp_path / "out"), *words.split()])
    assert end.value.code == 2
    assert "no flight" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()
