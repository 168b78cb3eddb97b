"""Training a policy: what it writes, that it goes on where it was killed, that it learns."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from safetensors import safe_open

from swarm_envs import swap_v0
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.policy import FILE, PolicyAgent
from swarm_envs.agents.policy_file import Policy, PolicyNote
from swarm_envs.cli import main
from swarm_envs.commands.train import setting
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.judging import choosing_seeds
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import completed

TINY = [
    *("--drones", "2", "--environments", "8", "--rollout", "8", "--batch-size", "64"),
    *("--hidden", "8", "8", "--steps", "2000", "--checkpoint-rollouts", "3", "--judge-every", "2"),
    *("--judge-episodes", "4", "--num-neighbors", "1", "--interactions", "none", "--passes", "2"),
    *("--no-tensorboard", "--seed", "5"),
]
STEPS = 2048  # 2,000 rounded up to rollouts of 2 * 8 * 8


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that nothing interrupted."""
    out = tmp_path_factory.mktemp("whole")
    assert main(["train", *TINY, "--out", str(out)]) == 0
    return out


def test_a_run_is_written_and_its_policy_flies(whole, capsys):
    report = json.loads((whole / "report.json").read_text())
    assert report["steps"] == STEPS
    assert [float(row["step"]) for row in curve(whole)][-1] == STEPS
    assert all(row["random_success"] != "" for row in curve(whole)[-1:])
    assert report["config"]["seed"] == 5
    agent = load(whole)
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.provenance["config"] == report["config"]
    arguments = ["--drones", "2", "--episodes", "2", "--horizon-s", "0.5", "--interactions", "none"]
    assert main(["evaluate", "--agent", str(whole), *arguments]) == 0
    for count in ("3", "1"):
        assert main(["evaluate", "--agent", str(whole), *arguments[2:], "--drones", count]) == 1
        said = capsys.readouterr().out
        assert f"trained for teams of 2 drones, but the environment has {count}" in said


def test_killed_it_goes_on_and_ends_with_the_same_policy(whole, tmp_path, capsys):
    out = tmp_path / "run"
    command = [sys.executable, "-m", "swarm_envs", "train", *TINY, "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 240
    while not (out / "checkpoint.safetensors").is_file():
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "report.json").exists()
    assert main(["train", *TINY, "--out", str(out)]) == 0
    assert "going on from the checkpoint at" in capsys.readouterr().out
    assert (out / FILE).read_bytes() == (whole / FILE).read_bytes()
    assert curve(out) == curve(whole)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "--task swap --drones 4"),
        ({"layout": "circle", "drones": (2, 4)}, "--task swap --layout circle --drones 4"),
        ({"team": ("SL", "SSLL"), "environments": 64}, "--task swap --team SSLL"),
    ],
)
def test_a_run_says_how_it_is_flown_as_it_was_trained(options, words):
    assert setting(TrainConfig(out=Path("a"), **options)) == words.split()


def test_a_finished_run_stays_as_it_is(whole, capsys):
    before = {file.name: file.read_bytes() for file in whole.iterdir()}
    assert main(["train", *TINY, "--out", str(whole)]) == 0
    assert "was finished before" in capsys.readouterr().out
    assert main(["train", *TINY, "--out", str(whole), "--discount", "0.9"]) == 1
    assert "discount is 0.98 there, 0.9 here" in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in whole.iterdir()} == before


@pytest.mark.parametrize(("action", "width"), [("velocity", 3), ("ctbr", 4)])
def test_a_policy_of_another_action_flies_with_that_one_alone(action, width, tmp_path):
    short = [*TINY, "--steps", "128", "--action", action, "--out", str(tmp_path)]
    assert main(["train", *short]) == 0
    agent = load(str(tmp_path))
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.note.action == agent.requires["action"] == action
    env = swap_v0.parallel_env(num_drones=2, physics="batch", **agent.requires)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    assert {row.shape for row in agent.act(observations, None).values()} == {(width,)}
    env.close()
    other = swap_v0.parallel_env(num_drones=2, **{**agent.requires, "action": "acceleration"})
    other.reset(seed=0)
    with pytest.raises(ValueError, match=f"requires action='{action}'"):
        agent.reset(other, 0)
    other.close()


def test_a_run_from_before_there_was_a_choice_of_actions_is_the_same_run(whole, tmp_path, capsys):
    report = json.loads((whole / "report.json").read_text())
    assert report["config"].pop("action") == "acceleration"
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert main(["train", *TINY, "--out", str(tmp_path)]) == 0
    assert "was finished before" in capsys.readouterr().out
    assert main(["train", *TINY, "--action", "velocity", "--out", str(tmp_path)]) == 1
    assert "action is acceleration there, velocity here" in capsys.readouterr().err


def test_an_unfinished_run_takes_no_other_options_and_damage_is_named(whole, tmp_path, capsys):
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes((whole / "checkpoint.safetensors").read_bytes())
    assert main(["train", *TINY, "--out", str(tmp_path), "--seed", "6"]) == 1
    assert "seed is 5 there, 6 here" in capsys.readouterr().err
    for content in (path.read_bytes()[:-7], b"\x80\x04K\x01."):
        path.write_bytes(content)
        assert main(["train", *TINY, "--out", str(tmp_path)]) == 1
        assert "checkpoint.safetensors' is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--task", "swop"], "did you mean 'swap_v0'"),
        (["--layout", "stacked"], "valid: 'circle', 'random'"),
        (["--task", "formation", "--layout", "cuba"], "did you mean 'cube'"),
        (["--json", "a.txt"], "must end in .json"),
    ],
)
def test_what_cannot_be_trained_is_refused(options, why, tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path / "run"), *options]) == 2
    assert why in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *[("--steps", "0"), ("--batch-size", "1000"), ("--discount", "1.5"), ("--seed", "-1")],
        *[("--decision-rate", "7"), ("--second-stage", "1"), ("--horizon-s", "nan")],
        ("--fewest", "5"),
    ],
)
def test_impossible_numbers_are_refused(option, value, capsys):
    with pytest.raises(SystemExit) as end:
        main(["train", "--out", "never", option, value])
    assert end.value.code == 2
    assert option in capsys.readouterr().err


def test_the_agent_acts_as_the_network_that_was_trained():
    config = TrainConfig(out=Path("never"), drones=2, environments=4, batch_size=256)
    learner = PpoLearner(completed(config, "swap_v0"), "swap_v0")
    agent = PolicyAgent(
        Policy(PolicyNote("swap_v0", 2, "acceleration", 10, 3), learner.actor(), {})
    )
    rows = learner.env.venv.reset()
    told, _ = learner.model.predict(learner.env.reset(), deterministic=True)
    rows = learner.env.cores[0].rows.reshape(8, -1)
    np.testing.assert_allclose(agent.act_batch(rows), told, atol=1e-6)
    assert learner.model.observation_space.shape == (18 + 17 * 3,)
    learner.close()


def test_a_checkpoint_holds_all_of_adam(whole):
    with safe_open(whole / "checkpoint.safetensors", framework="pt") as file:
        names = set(file.keys())
        steps = {float(file.get_tensor(name)) for name in names if name.endswith(".step")}
        moments = [file.get_tensor(n) for n in names if n.endswith(".exp_avg_sq")]
    assert len(moments) == sum(name.startswith("policy.") for name in names)
    assert all(
        bool((moment >= 0).all()) and bool(torch.isfinite(moment).all()) for moment in moments
    )
    second = (
        STEPS // 128
        - TrainConfig(
            out=Path("never"), drones=2, environments=8, rollout=8, batch_size=64, steps=2000
        ).first_stage
    )
    assert steps == {float(second * 2 * 2)}  # rollouts, passes, batches since Adam was fresh


def test_segments_cover_every_rollout_once_and_keep_the_stages_apart():
    for steps, stage, every in ((3_000_000, 0.25, 20), (16_384, 0.25, 20), (500_000, 0.0, 7)):
        config = TrainConfig(
            out=Path("never"), steps=steps, second_stage=stage, checkpoint_rollouts=every
        )
        segments = config.segments()
        assert [k for segment in segments for k in segment] == list(range(config.rollouts))
        assert all(len(segment) <= every for segment in segments)
        assert config.rollouts * config.rollout_steps - steps < config.rollout_steps
        stages = {segment.start < config.first_stage for segment in segments}
        assert all(s.stop <= config.first_stage or s.start >= config.first_stage for s in segments)
        assert len(stages) == (2 if config.first_stage < config.rollouts else 1)


def test_policies_are_not_chosen_on_the_seeds_of_reports():
    chosen = set(choosing_seeds(4096))
    assert all(not chosen & set(frozen_seeds(seed, 4096)) for seed in range(20))
