"""SAC and MAPPO: they go on where they were stopped, act as they learned, and say what they are."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from safetensors import safe_open

from swarm_envs.agents import load
from swarm_envs.agents.policy import FILE, PolicyAgent
from swarm_envs.agents.policy_file import Policy, PolicyNote
from swarm_envs.cli import main
from swarm_envs.files import claimed
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.mappo import MappoLearner, Networks, generalised_advantages
from swarm_envs.training.rl.recipes import completed
from swarm_envs.training.rl.sac import SacLearner
from swarm_envs.training.rl.sac_options import SacOptions

COMMON = [
    *("--drones", "2", "--environments", "8", "--hidden", "8", "8", "--num-neighbors", "1"),
    *("--judge-every", "2", "--judge-episodes", "4", "--interactions", "none", "--seed", "5"),
    *("--no-tensorboard", "--no-progress"),
]
TINY = {
    "mappo": [
        *("--rollout", "8", "--batch-size", "64", "--passes", "2", "--steps", "1280"),
        *("--checkpoint-rollouts", "3"),
    ],
    "sac": [
        *("--steps", "1536", "--checkpoint-rollouts", "6", "--sac.gradient-steps", "4"),
        *("--sac.learning-starts", "200", "--sac.buffer-size", "1000", "--sac.batch-size", "32"),
        *("--sac.rollout", "4"),
    ],
}
STEPS = {"mappo": 1280, "sac": 1536}
LEARNERS: dict[str, Any] = {"mappo": MappoLearner, "sac": SacLearner}
ALGORITHMS = sorted(TINY)


def command(algo: str, out: Path, *more: str) -> list[str]:
    return ["train", "--algo", algo, *COMMON, *TINY[algo], "--out", str(out), *more]


def curve(folder: Path) -> list[dict[str, str]]:
    with (folder / "curve.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, Path]:
    """Runs that nothing interrupted."""
    runs = {algo: tmp_path_factory.mktemp(algo) for algo in ALGORITHMS}
    for algo, out in runs.items():
        assert main(command(algo, out)) == 0
    return runs


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_a_run_is_written_and_its_policy_flies(algo, whole):
    report = json.loads((whole[algo] / "report.json").read_text())
    assert report["config"]["algo"] == algo
    assert report["steps"] == float(curve(whole[algo])[-1]["step"]) == STEPS[algo]
    assert isinstance(load(str(whole[algo])), PolicyAgent)
    arguments = ["--drones", "2", "--episodes", "2", "--horizon-s", "0.5", "--interactions", "none"]
    assert main(["evaluate", "--agent", str(whole[algo]), *arguments]) == 0


@pytest.mark.parametrize("algo", ALGORITHMS)
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
    assert "going on from the checkpoint at" in capsys.readouterr().out
    assert (tmp_path / FILE).read_bytes() == (whole[algo] / FILE).read_bytes()
    assert curve(tmp_path) == curve(whole[algo])
    with (
        safe_open(tmp_path / "checkpoint.safetensors", "np") as here,
        safe_open(whole[algo] / "checkpoint.safetensors", "np") as there,
    ):
        names = set(there.keys())
        assert set(here.keys()) == names
        for name in names:
            assert np.array_equal(here.get_tensor(name), there.get_tensor(name)), name


def test_runs_of_another_algorithm_are_named_and_refused(whole, tmp_path, capsys):
    assert main(command("mappo", whole["sac"])) == 1
    said = capsys.readouterr().err
    assert "finished run with other options: algo is sac there, mappo here; choose" in said
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes((whole["mappo"] / "checkpoint.safetensors").read_bytes())
    assert main(command("sac", tmp_path)) == 1
    assert "other options: algo is mappo there, sac here; choose" in capsys.readouterr().err


def test_a_folder_that_another_run_writes_into_is_refused(tmp_path, capsys):
    with claimed(tmp_path):
        assert main(command("mappo", tmp_path)) == 1
    assert "writes into" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == [".lock"]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--algo", "sac", "--clip", "0.1"], "--clip was given (0.1), but --algo sac has no such"),
        (["--sac.rollout", "2"], "--sac.rollout was given (2), but --algo ppo has no such"),
        (["--pooling", "max"], "--pooling was given, but only --encoder deep-set has sets"),
        (["--algo", "sac", "--sac.batch-size", "0"], "--sac.batch-size"),
        (["--algo", "sac", "--sac.smoothing", "2"], "--sac.smoothing is 2.0"),
    ],
)
def test_options_that_do_not_belong_are_refused(options, why, capsys):
    with pytest.raises(SystemExit) as end:
        main(["train", "--out", "never", *options])
    assert end.value.code == 2
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert why in said


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_the_agent_acts_as_the_network_that_was_trained(algo):
    """Of SAC the last layer's tanh too."""
    sizes: dict[str, Any] = {"mappo": {"batch_size": 64}, "sac": {}}[algo]
    config = TrainConfig(out=Path("never"), algo=algo, drones=2, environments=4, **sizes)
    learner: Any = make_learner(config, "swap_v0")
    note = PolicyNote("swap_v0", 2, "acceleration", 10, 3)
    agent = PolicyAgent(Policy(note, learner.actor(), {}))
    told = learner.env.reset()
    rows = learner.env.cores[0].rows.reshape(8, -1)
    if algo == "sac":
        wanted, _ = learner.model.predict(told, deterministic=True)
    else:
        wanted = learner.networks.actor(torch.from_numpy(told)).detach().numpy()
    assert np.abs(wanted).max() > 1e-3
    np.testing.assert_allclose(agent.act_batch(rows), wanted, atol=1e-6)
    learner.close()


def test_sac_remembers_the_latest_decisions_and_checkpoints_of_its_end_none(whole, tmp_path):
    options = SacOptions(rollout=5, learning_starts=1000, buffer_size=120)
    config = TrainConfig(
        out=Path("never"), algo="sac", drones=2, environments=4, steps=200, sac=options
    )
    learner = SacLearner(completed(config, "swap_v0"), "swap_v0")
    learner.fly(range(2))
    first = learner.tensors()["memory.actions"].clone()
    assert first.shape == (10, 8, 3)
    learner.fly(range(2, 4))
    memory = learner.tensors()["memory.actions"]
    assert memory.shape == (15, 8, 3)  # 120 decisions, 8 at a time
    assert torch.equal(memory[5:10], first[5:])  # the others were written over
    assert not torch.equal(memory[:5], first[:5])
    cut = learner.tensors()["memory.timeouts"]
    assert cut[9].all() and not cut[5:9].any()  # no return reaches into the next segment
    learner.fly(range(4, 5))
    assert not any(name.startswith("memory") for name in learner.tensors())
    learner.close()


def test_the_critic_sees_itself_first_and_the_team_in_turn():
    config = TrainConfig(out=Path("never"), algo="mappo", drones=3, environments=2, batch_size=96)
    learner = MappoLearner(completed(config, "swap_v0"), "swap_v0")
    learner.core.reset([0, 1])
    told = learner._told()
    seen, states = learner._seen(told).numpy(), learner.core.team_state()
    for e in range(2):
        for i in range(3):
            others = [states[e, (i + k) % 3] for k in (1, 2)]
            assert np.array_equal(seen[e, i], np.concatenate([told[e, i].numpy(), *others]))
    learner.close()


def test_advantages_are_weighed_sums_of_later_errors_of_the_episode():
    draws, decay = np.random.default_rng(0), 0.8
    errors, ended = draws.normal(size=(12, 5)), draws.random((12, 5)) < 0.2
    found = generalised_advantages(torch.from_numpy(errors), torch.from_numpy(ended), decay)
    for column in range(5):
        for t in range(12):
            last = next((k for k in range(t, 12) if ended[k, column]), 11)
            later = np.arange(t, last + 1)
            expected = float(np.sum(decay ** (later - t) * errors[later, column]))
            assert float(found[t, column]) == pytest.approx(expected, abs=1e-12)


def test_values_are_in_units_of_the_spread_of_returns():
    torch.manual_seed(0)
    networks = Networks(told=4, seen=6, hidden=(8,), actions=3, deviation=0.5)
    returns = 40.0 + 3.0 * torch.randn(10_000)
    networks.note_returns(returns)
    mean, deviation = networks.spread()
    assert float(mean) == pytest.approx(float(returns.mean()), rel=1e-4)
    assert float(deviation) == pytest.approx(float(returns.std()), rel=1e-2)
    for _ in range(400):
        networks.note_returns(-returns)
    assert float(networks.spread()[0]) == pytest.approx(-float(returns.mean()), rel=0.02)
    seen = torch.randn(5, 6)
    mean, deviation = networks.spread()
    foreseen = networks.critic(seen)[:, 0] * deviation + mean
    assert torch.allclose(networks.value(seen), foreseen)


def test_a_decision_is_as_probable_as_the_normal_distribution_says():
    networks = Networks(told=4, seen=6, hidden=(8,), actions=3, deviation=0.3)
    means, actions = torch.randn(7, 3), torch.randn(7, 3)
    normal = torch.distributions.Normal(means, 0.3)
    wanted = normal.log_prob(actions).sum(-1)
    assert torch.allclose(networks.log_probability(means, actions), wanted, atol=1e-4)
