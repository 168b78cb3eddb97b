"""Training a policy by PPO, MAPPO, SAC and DAgger: what is written, resumption, kills, refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from safetensors.numpy import load_file

from swarm_envs import swap_v0
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.policy import FILE, PolicyAgent
from swarm_envs.cli import main
from swarm_envs.commands.train import setting
from swarm_envs.training.rl.dagger import DaggerLearner
from swarm_envs.training.rl.mappo import MappoLearner
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import choosing_seeds
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.sac import SacLearner

COMMON = (
    "--drones 2 --environments 8 --hidden 8 8 --num-neighbors 1 --judge-every 2 --judge-episodes 4 "
    "--interactions none --seed 5 --no-tensorboard --no-progress"
)
ON_POLICY = "--n-steps 8 --batch-size 64 --n-epochs 2 --checkpoint-rollouts 3"
TINY = {
    "ppo": f"{ON_POLICY} --steps 2000",
    "mappo": f"{ON_POLICY} --steps 1280",
    "sac": "--steps 1536 --checkpoint-rollouts 6 --sac.gradient-steps 4 --sac.learning-starts 200 "
    "--sac.buffer-size 1000 --sac.batch-size 32 --sac.train-freq 4",
    "dagger": "--steps 1536 --checkpoint-rollouts 6 --dagger.gradient-steps 2 "
    "--dagger.train-freq 4 --dagger.batch-size 32 --dagger.buffer-size 500 "
    "--dagger.teacher fast-line circle=roundabout",
}
STEPS = {"ppo": 2048, "mappo": 1280, "sac": 1536, "dagger": 1536}  # rounded up to rollouts
LEARNERS: dict[str, Any] = {
    **{"ppo": PpoLearner, "mappo": MappoLearner, "sac": SacLearner, "dagger": DaggerLearner}
}
SHORT = ["--drones", "2", "--episodes", "2", "--horizon-s", "0.5", "--interactions", "none"]
every_algorithm = pytest.mark.parametrize("algo", TINY)


def command(algo: str, out: Path, *more: str) -> list[str]:
    options = f"--algo {algo} {COMMON} {TINY[algo]}".split()
    return ["train", *options, "--out", str(out), *more]


def curve(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "curve.csv").read_text(encoding="utf-8").splitlines()))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, Path]:
    """Runs that nothing interrupted."""
    runs = {algo: tmp_path_factory.mktemp(algo) for algo in TINY}
    for algo, out in runs.items():
        assert main(command(algo, out)) == 0
    return runs


@every_algorithm
def test_a_run_is_written_and_its_policy_flies(algo, whole, capsys):
    report = json.loads((whole[algo] / "report.json").read_text())
    assert (report["config"]["algo"], report["config"]["seed"]) == (algo, 5)
    last = curve(whole[algo])[-1]
    assert report["steps"] == float(last["step"]) == STEPS[algo]
    assert last["random_success"] != ""
    agent = load(whole[algo])
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.provenance["config"] == report["config"]
    assert main(["evaluate", "--agent", str(whole[algo]), *SHORT]) == 0
    for count in ("3", "1"):
        assert main(["evaluate", "--agent", str(whole[algo]), *SHORT, "--drones", count]) == 2
        said = capsys.readouterr().err
        assert f"trained for teams of 2 drones, but the environment has {count}" in said


@every_algorithm
@pytest.mark.parametrize("segments", [1, 3])
def test_stopped_after_a_segment_it_goes_on_to_the_same_policy(
    algo, segments, whole, tmp_path, monkeypatch, capsys
):
    """A run that ends after some checkpoints, with another's random numbers in between."""
    fly, flown = LEARNERS[algo].fly, list[range]()

    def stopped(learner, segment, watch=None):
        if len(flown) == segments:
            raise KeyboardInterrupt
        flown.append(segment)
        return fly(learner, segment, watch)

    monkeypatch.setattr(LEARNERS[algo], "fly", stopped)
    assert main(command(algo, tmp_path)) == 130
    monkeypatch.undo()
    steps = [row["step"] for row in curve(tmp_path)]
    assert steps == [row["step"] for row in curve(whole[algo])][:segments]
    np.random.seed(99)  # noqa: NPY002  # what Stable-Baselines3 draws from
    torch.manual_seed(99)
    assert main(command(algo, tmp_path)) == 0
    assert "resuming from the checkpoint at" in capsys.readouterr().out
    assert (tmp_path / FILE).read_bytes() == (whole[algo] / FILE).read_bytes()
    assert curve(tmp_path) == curve(whole[algo])
    here, there = (load_file(out / "checkpoint.safetensors") for out in (tmp_path, whole[algo]))
    assert here.keys() == there.keys()
    for name, tensor in there.items():
        assert np.array_equal(here[name], tensor), name


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "--task swap --drones 4"),
        ({"layout": "circle", "drones": (2, 4)}, "--task swap --layout circle --drones 4"),
        ({"team": ("SL", "SSLL"), "environments": 64}, "--task swap --team SSLL"),
    ],
)
def test_a_run_says_how_it_is_flown_as_it_was_trained(options, words):
    assert setting(RlConfig(out=Path("a"), **options)) == words.split()


def test_a_finished_run_stays_as_it_is(whole, capsys):
    out = whole["ppo"]
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    assert main(command("ppo", out)) == 0
    assert "was finished before" in capsys.readouterr().out
    assert main(command("ppo", out, "--gamma", "0.9")) == 1
    assert "gamma is 0.98 there, 0.9 here" in capsys.readouterr().err
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before


def test_a_run_from_before_there_was_a_choice_of_actions_is_the_same_run(whole, tmp_path, capsys):
    report = json.loads((whole["ppo"] / "report.json").read_text())
    assert report["config"].pop("action") == "acceleration"
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert main(command("ppo", tmp_path)) == 0
    assert "was finished before" in capsys.readouterr().out
    assert main(command("ppo", tmp_path, "--action", "velocity")) == 1
    assert "action is acceleration there, velocity here" in capsys.readouterr().err


@pytest.mark.parametrize(("action", "width"), [("velocity", 3), ("ctbr", 4)])
def test_a_policy_of_another_action_flies_with_that_one_alone(action, width, tmp_path):
    assert main(command("ppo", tmp_path, "--steps", "128", "--action", action)) == 0
    agent = load(str(tmp_path))
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.note.action == agent.requires["action"] == action
    env = swap_v0.parallel_env(num_drones=2, physics="batch", **agent.requires)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    assert {row.shape for row in agent.act(observations, None).values()} == {(width,)}
    other = swap_v0.parallel_env(num_drones=2, **{**agent.requires, "action": "acceleration"})
    other.reset(seed=0)
    with pytest.raises(ValueError, match=f"requires action='{action}'"):
        agent.reset(other, 0)


def test_an_unfinished_run_takes_no_other_options_and_damage_is_named(whole, tmp_path, capsys):
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes((whole["ppo"] / "checkpoint.safetensors").read_bytes())
    assert main(command("ppo", tmp_path, "--seed", "6")) == 1
    assert "seed is 5 there, 6 here" in capsys.readouterr().err
    assert main(command("sac", tmp_path)) == 1
    assert "other options: algo is ppo there, sac here; choose" in capsys.readouterr().err
    assert main(command("mappo", whole["sac"])) == 1
    said = capsys.readouterr().err
    assert "finished run with other options: algo is sac there, mappo here; choose" in said
    for content in (path.read_bytes()[:-7], b"\x80\x04K\x01."):
        path.write_bytes(content)
        assert main(command("ppo", tmp_path)) == 1
        assert "checkpoint.safetensors' is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--task swop", "did you mean 'swap_v1'"),
        ("--layout stacked", "valid: 'circle', 'random'"),
        ("--json a.txt", "must end in .json"),
        ("--batch-size 1000", "--batch-size is 1000, but must divide the 16384 decisions"),
        ("--gamma 1.5", "--gamma is 1.5, but must be a number in [0, 1]"),
        ("--decision-rate 7", "--decision-rate is 7"),
        ("--horizon-s nan", "--horizon-s is nan"),
        ("--fewest 5", "--fewest is 5, but must be from 1 to 4"),
        ("--algo sac --clip-range 0.1", "--clip-range was given (0.1), but --algo sac has no such"),
        ("--sac.train-freq 2", "--sac.train-freq was given (2), but --algo ppo has no such"),
        ("--pooling max", "--pooling was given, but only --encoder deep-set has it"),
        ("--most 3", "--most is 3, but must be at least 4"),
        ("--start-kl 1", "--start-kl was given, but no --start"),
        ("--algo dagger --crash 2", "--crash was given (2.0), but --algo dagger has no such"),
        ("--algo sac --sac.batch-size 0", "--sac.batch-size"),
        ("--task crowd", "--layout all is learned by --algo dagger; name one layout"),
        ("--controller hover", "controller is 'hover', but must be a shipped agent with a con"),
        ("--features raw", "unknown features 'raw'; valid: 'full-1'"),
        ("--drones 4 4", "--drones is (4, 4) and --team (); name teams, each once"),
        ("--drones 2 4 --environments 3", "multiple of the 2 teams"),
        ("--drones 4 0", "--drones is (4, 0)"),
        ("--set-hidden 0", "--set-hidden is '0', but must be a sequence, each an integer"),
        ("--activation relu --algo sac", "--algo sac has no such option"),
    ],
)
def test_what_cannot_be_trained_is_refused(options, why, tmp_path, refused):
    assert why in refused("train", "--out", tmp_path / "run", *options.split())
    assert not (tmp_path / "run").exists()


def test_segments_cover_every_rollout_once_and_keep_the_stages_apart():
    for steps, stage, every in ((3_000_000, 0.25, 20), (16_384, 0.25, 20), (500_000, 0.0, 7)):
        config = RlConfig(
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
