"""Sweeps of training runs: the same policies by one process and by several, and what they add."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs.cli import main
from swarm_envs.commands.checks import Misuse
from swarm_envs.commands.train_sweep import (
    check_marker,
    over_seeds,
    parse,
    train_arguments,
    write_marker,
)

TINY = [
    *("drones=2", "environments=8", "n_steps=8", "batch_size=64", "hidden=8,8", "steps=500"),
    *(
        "judge_episodes=4",
        "num_neighbors=1",
        "interactions=none",
        "n_epochs=1",
        "tensorboard=false",
    ),
]
SWEEP = ["train-sweep", "--seeds", "0", "1", "--set", *TINY, "--episodes", "6"]


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("serial")
    assert main([*SWEEP, "--out", str(out)]) == 0
    return out


def test_a_sweep_is_its_runs(serial, tmp_path):
    """A run of a sweep is what `train` makes, and its rates are those of `evaluate`."""
    arguments = train_arguments(TINY)
    assert main(["train", *arguments, "--seed", "1", "--out", str(tmp_path / "run")]) == 0
    alone, run = tmp_path / "run", serial / "runs" / "seed-1"
    name = "policy.safetensors"
    assert (alone / name).read_bytes() == (run / name).read_bytes()
    given = ["--drones", "2", "--interactions", "none", "--episodes", "6", "--seed", "7"]
    given += ["--layout", "random", "--json", str(tmp_path / "out.json")]
    assert main(["evaluate", "--agent", str(run), *given]) == 0
    rates = json.loads((serial / "sweep.json").read_text())["variants"][0]["runs"][1]["measured"]
    assert (
        rates["random_success"] == json.loads((tmp_path / "out.json").read_text())["success_rate"]
    )


def test_processes_train_the_same_and_a_run_that_fails_is_named(serial, tmp_path, capsys):
    """The folder of one run holds another; the second call finds the rest finished."""
    other = tmp_path / "hidden-4" / "seed-1"
    other.mkdir(parents=True)
    (other / "report.json").write_text('{"config": {}}')
    sweep = [*SWEEP, "--compare", "hidden=8,8", "hidden=4", "--out", str(tmp_path)]
    assert main([*sweep, "--workers", "2"]) == 1
    assert "hidden=4 seed 1 FAILED: ValueError" in capsys.readouterr().err
    same, small = json.loads((tmp_path / "sweep.json").read_text())["variants"]
    (whole,) = json.loads((serial / "sweep.json").read_text())["variants"]
    assert same["measured"] == whole["measured"]
    assert len(small["measured"]["random_success"]["each"]) == 1
    for seed in "01":
        policy = Path(f"seed-{seed}") / "policy.safetensors"
        expected = (serial / "runs" / policy).read_bytes()
        assert (tmp_path / "hidden-8-8" / policy).read_bytes() == expected
    (other / "report.json").unlink()
    before = (tmp_path / "hidden-8-8" / "seed-0" / "report.json").stat().st_mtime_ns
    assert main(sweep) == 0
    assert (tmp_path / "hidden-8-8" / "seed-0" / "report.json").stat().st_mtime_ns == before


def test_settings_are_arguments_of_train():
    given = ["hidden=32,16", "hard_starts=false", "learning-rate=1e-4"]
    config = parse([*train_arguments(given), "--out", "never"])
    assert (config.hidden, config.hard_starts, config.learning_rate) == ((32, 16), False, 1e-4)
    config = parse([*train_arguments(["algo=sac", "sac.batch_size=256"]), "--out", "never"])
    assert config.sac.batch_size == 256


@pytest.mark.parametrize(
    ("setting", "why"),
    [("hidden", "write NAME=VALUE"), ("hidden=", "write NAME=VALUE"), ("seed=3", "has its own")],
)
def test_what_is_no_setting_is_refused(setting, why):
    with pytest.raises(Misuse, match=why):
        train_arguments([setting])


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--set", "hiden=3"], "hiden"),
        (["--set", "task=rink"], "ring"),
        (["--compare", "hidden=3", "hidden,3"], "each once"),
    ],
)
def test_what_makes_no_sweep_is_refused_before_anything_is_trained(
    arguments, why, tmp_path, refused
):
    assert why in refused("train-sweep", "--out", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


def test_a_machine_that_does_not_see_the_folder_is_named(tmp_path):
    digest = write_marker(tmp_path / "options.json", {"seeds": [1]})
    check_marker(tmp_path / "options.json", digest)
    (tmp_path / "options.json").write_text("{}")
    for path in (tmp_path / "options.json", tmp_path / "elsewhere.json"):
        with pytest.raises(OSError, match="storage that all machines share"):
            check_marker(path, digest)


def test_the_summary_leaves_out_a_quarter_at_each_end():
    rates = [0.0, 0.5, 0.6, 0.7, 1.0]
    found = over_seeds([{"measured": {"success": rate}} for rate in rates])["success"]
    assert found["iqm"] == pytest.approx(0.6)
    low, high = found["interval"]
    assert 0.0 <= low < 0.6 < high <= 1.0
    assert found["each"] == rates
