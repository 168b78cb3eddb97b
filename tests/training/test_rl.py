"""Training by Stable-Baselines3 and by DAgger: what is written, resumed and refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC, TD3

from swarm_envs import swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.policy import FILE, PolicyAgent
from swarm_envs.cli import main
from swarm_envs.commands.train import setting
from swarm_envs.envs.core import SwarmCore
from swarm_envs.training import SharedPolicyVecEnv
from swarm_envs.training.rl import dagger, sb3
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig
from swarm_envs.training.rl.runs import make_setting, parts_of
from swarm_envs.training.rl.validation import validation_seeds
from tests.helpers.interrupts import calls_of

COMMON = (
    "--drones 2 --environments 8 --hidden 8 8 --neighbors 1 --evaluations 2 "
    "--evaluation-episodes 4 --interactions none --seed 5 --no-progress"
)
OFF_POLICY = "--steps 640 --set learning_starts=200 buffer_size=1000 batch_size=32 gradient_steps=2"
TINY = {
    "ppo": "--steps 2048 --set n_steps=8 batch_size=64 n_epochs=2",
    "sac": OFF_POLICY,
    "td3": OFF_POLICY,
    "dagger": "--steps 1536 --checkpoint-rollouts 6 --dagger.gradient-steps 2 "
    "--dagger.train-freq 4 --dagger.batch-size 32 --dagger.buffer-size 500 "
    "--dagger.teacher fast-line circle=roundabout",
}
SHORT = ["--drones", "2", "--episodes", "2", "--horizon-s", "0.5", "--interactions", "none"]
every_algorithm = pytest.mark.parametrize("algo", TINY)


def command(algo: str, out: Path, *more: str) -> list[str]:
    options = f"--algo {algo} {COMMON} {TINY[algo]}".split()
    return ["train", *options, "--out", str(out), *more]


def curve(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "progress.csv").read_text(encoding="utf-8").splitlines()))


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
    assert report["steps"] >= report["last"]["step"] > 0
    assert {"random_success", "circle_success"} <= report["chosen"].keys()
    assert len(curve(whole[algo])) > 1
    if algo != "dagger":
        assert "rollout/ep_rew_mean" in curve(whole[algo])[-1]
        evaluated = [row for row in curve(whole[algo]) if row["evaluation/random_success"]]
        steps = [float(row["time/total_timesteps"]) for row in evaluated]
        assert steps[-1] == report["last"]["step"] and len(steps) > 1
        assert float(evaluated[-1]["evaluation/random_crash"]) == report["last"]["random_crash"]
    agent = load(whole[algo])
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.provenance["config"] == report["config"]
    assert main(["evaluate", "--agent", str(whole[algo]), *SHORT]) == 0
    for count in ("3", "1"):
        assert main(["evaluate", "--agent", str(whole[algo]), *SHORT, "--drones", count]) == 2
        printed = capsys.readouterr().err
        assert f"trained for teams of 2 drones, but the environment has {count}" in printed


def test_the_same_seed_gives_the_same_policy(whole, tmp_path):
    assert main(command("ppo", tmp_path)) == 0
    assert (tmp_path / FILE).read_bytes() == (whole["ppo"] / FILE).read_bytes()


@pytest.mark.parametrize(("given", "costs"), [("crash", {-4.0, -2.0}), ("proximity", set())])
def test_the_schedule_leaves_a_given_cost_of_proximity(given, costs, tmp_path):
    with calls_of(SwarmCore, "set_reward_weights") as calls:
        assert main(command("ppo", tmp_path, "--env", f"reward_weights={{'{given}': -1.0}}")) == 0
    assert {weights["proximity"] for _, weights in calls} == costs


OWN_TASKS = """
from dataclasses import dataclass
import numpy as np
from swarm_envs.tasks.base import Placement, Task
from swarm_envs.tasks.rewards import REWARD_WEIGHTS
from swarm_envs.tasks.swap import SwapTask

@dataclass(frozen=True)
class Plain(Task):
    def draw(self, rng, start=None, goal=None):
        row = np.array([[0.0, 0.5 * i, 1.0] for i in range(len(self.team))])
        return Placement(row, (row + np.array([0.6, 0.0, 0.0]))[None])

@dataclass(frozen=True)
class Careful(SwapTask):
    default_weights = {**REWARD_WEIGHTS, "proximity": -10.0}

@dataclass(frozen=True)
class Usual(SwapTask):
    pass
"""


@pytest.mark.parametrize(
    ("task", "costs"), [("Plain", set()), ("Careful", set()), ("Usual", {-4.0, -2.0})]
)
def test_the_schedule_leaves_the_weights_of_own_tasks(task, costs, tmp_path):
    file = tmp_path / "own.py"
    file.write_text(OWN_TASKS, encoding="utf-8")
    given = command("ppo", tmp_path / "run", "--task", f"{file}:{task}")
    with calls_of(SwarmCore, "set_reward_weights") as calls:
        assert main(given) == 0
    assert {weights["proximity"] for _, weights in calls} == costs


@pytest.mark.parametrize(
    ("task", "given", "expected"),
    [
        ("swap_v1", "spacing_m=0.4", {"spacing_m": 0.4}),
        ("formation_v1", "turn_rad=(0.0, 0.5)", {"turn_rad": [0.0, 0.5]}),
        ("swap_v1", "reward_weights={'at_goal': 5.0}", {"at_goal": 5.0}),
    ],
)
def test_given_fields_are_those_of_the_curriculum(task, given, expected):
    config = RlConfig(out=Path("a"), env=(given,), hidden=(8,))
    trained = make_setting(config, task).blueprints[0].task
    found = {**vars(trained), **trained.reward_weights}
    assert {name: found[name] for name in expected} == expected
    assert type(trained).__name__ in ("SwapCurriculum", "FormationCurriculum")


def test_given_fields_are_those_of_every_part():
    config = RlConfig(out=Path("a"), algo="dagger", env=("reach_m=(1.0, 1.5)",), hidden=(8,))
    setting = make_setting(config, "crowd_v0")
    parts = parts_of(setting.config, "crowd_v0", setting.blueprints[0].task)
    assert len(parts) > 1
    assert {tuple(task.reach_m) for _, task in parts.values()} == {(1.0, 1.5)}


def test_an_interrupted_run_of_dagger_ends_with_the_same_policy(whole, tmp_path, capsys):
    with calls_of(dagger.Dagger, "fly", killed_at=3):
        assert main(command("dagger", tmp_path)) == 130
    assert main(command("dagger", tmp_path)) == 0
    assert "resuming at" in capsys.readouterr().out
    assert (tmp_path / FILE).read_bytes() == (whole["dagger"] / FILE).read_bytes()
    assert curve(tmp_path) == curve(whole["dagger"])


def test_an_interrupted_run_of_stable_baselines3_goes_on(tmp_path, capsys):
    with calls_of(sb3.ProgressCallback, "_on_step", killed_at=100):
        assert main(command("ppo", tmp_path)) == 130
    models = [*(tmp_path / "checkpoints").glob("*.zip")]
    assert len(models) == 1
    first = (tmp_path / "progress.csv").read_bytes()
    assert main(command("ppo", tmp_path)) == 0
    assert "resuming at 1,024 steps" in capsys.readouterr().out
    assert first and (tmp_path / "progress.csv").read_bytes() == first
    assert (tmp_path / "progress_from_1024.csv").stat().st_size
    assert json.loads((tmp_path / "report.json").read_text())["steps"] == 2048


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "--task swap"),
        ({"layout": "circle", "drones": (2, 4)}, "--task swap --layout circle --drones 4"),
        ({"team": ("SL", "SSLL"), "environments": 64}, "--task swap --team SSLL"),
        (
            {"obstacles": "column=1:1:0.1", "world": "hall", "drones": 4},
            "--task swap --world hall --obstacles column=1:1:0.1 --drones 4",
        ),
        (
            {"observe_delay_s": 0.1, "observe_loss": 0.2, "randomization": "mass=0.9:1.1"},
            "--task swap --observe-delay-s 0.1 --observe-loss 0.2",
        ),
        (
            {"env": ("end_on_success=False", "force_rate=240")},
            "--task swap --force-rate 240 --env end_on_success=False",
        ),
    ],
)
def test_a_run_names_the_command_that_evaluates_it(options, words):
    assert setting(RlConfig(out=Path("a"), **options)) == words.split()


OWN_ALGORITHMS = """
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

class Mine(PPO):
    def __init__(self, policy, env, **given):
        super().__init__(policy, env, **{"n_steps": 8, "batch_size": 64, **given})

class Half(BaseFeaturesExtractor):
    def __init__(self, space):
        super().__init__(space, space.shape[0] // 2)

    def forward(self, rows):
        return rows[:, : self.features_dim]

class Other(Mine):
    def __init__(self, policy, env, policy_kwargs, **given):
        kwargs = {**policy_kwargs, "features_extractor_class": Half}
        super().__init__(policy, env, policy_kwargs=kwargs, **given)
"""


def test_an_algorithm_of_a_file_trains_to_the_end_of_a_rollout(tmp_path, capsys):
    file, out = tmp_path / "own.py", tmp_path / "out"
    file.write_text(OWN_ALGORITHMS)
    words = ["train", *COMMON.split(), "--steps", "100", "--out", str(out)]
    assert main([*words, "--algo", f"{file}:Mine"]) == 0
    assert "100 steps are rounded up to 128, whole rollouts of 8 steps of 16 drones" in (
        capsys.readouterr().out
    )
    assert json.loads((out / "report.json").read_text())["steps"] == 128


def test_a_network_that_no_policy_file_holds_is_refused_before_training(tmp_path, capsys):
    file, out = tmp_path / "own.py", tmp_path / "out"
    file.write_text(OWN_ALGORITHMS)
    words = ["train", *COMMON.split(), "--steps", "100", "--out", str(out)]
    assert main([*words, "--algo", f"{file}:Other"]) == 1
    assert "features extractor of the policy is Half, which cannot" in capsys.readouterr().err
    assert not list(out.glob("checkpoints/*"))


@pytest.mark.parametrize("algo", ["ppo", "dagger"])
def test_a_finished_run_stays_as_it_is(algo, whole, capsys):
    out = whole[algo]
    before = {file.name: file.read_bytes() for file in out.iterdir() if file.is_file()}
    assert main(command(algo, out)) == 0
    assert "is already complete" in capsys.readouterr().out
    assert main(command(algo, out, "--seed", "6")) == 1
    assert "seed is 5 there, 6 here" in capsys.readouterr().err
    assert {f.name: f.read_bytes() for f in out.iterdir() if f.is_file()} == before


def test_a_finished_run_of_stable_baselines3_continues_with_more_steps(tmp_path, capsys):
    assert main(command("ppo", tmp_path)) == 0
    assert main(command("ppo", tmp_path, "--steps", "3072")) == 0
    assert "resuming at 2,048 steps" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["steps"] == report["config"]["steps"] == 3072
    assert main(command("ppo", tmp_path, "--steps", "3200")) == 0
    assert "resuming at 3,072 steps" in capsys.readouterr().out
    assert main(command("ppo", tmp_path)) == 1
    assert "steps is 3200 there, 2048 here" in capsys.readouterr().err
    assert main(command("ppo", tmp_path, "--steps", "4096", "--seed", "6")) == 1


@pytest.mark.parametrize(("action", "width"), [("velocity", 3), ("ctbr", 4)])
def test_a_policy_of_another_action_flies_with_that_one_alone(action, width, tmp_path):
    assert main(command("ppo", tmp_path, "--steps", "128", "--action", action)) == 0
    agent = load(str(tmp_path))
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.note.action == agent.requires["action"] == action
    env = swap_v1.parallel_env(num_drones=2, physics="batch", **agent.requires)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    assert {row.shape for row in agent.act(observations, None).values()} == {(width,)}
    other = swap_v1.parallel_env(num_drones=2, **{**agent.requires, "action": "acceleration"})
    other.reset(seed=0)
    with pytest.raises(ValueError, match=f"requires action='{action}'"):
        agent.reset(other, 0)


def test_a_damaged_checkpoint_is_named(whole, tmp_path, capsys):
    path = tmp_path / "checkpoint.safetensors"
    content = (whole["dagger"] / path.name).read_bytes()
    for damaged in (content[:-7], b"\x80\x04K\x01."):
        path.write_bytes(damaged)
        assert main(command("dagger", tmp_path)) == 1
        assert "checkpoint.safetensors' is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--task swop", "did you mean 'swap'"),
        ("--layout stacked", "valid: 'circle', 'random'"),
        ("--json a.txt", "must end in .json"),
        ("--env decision_rat=7", "did you mean 'decision_rate'"),
        ("--env decision_rate=7", "--env has 'decision_rate', which has its own option; use --dec"),
        ("--env num_neighbors=2", "--env has 'num_neighbors', which has its own option; use --nei"),
        ("--decision-rate 7", "decision_rate is 7"),
        ("--horizon-s nan", "horizon_s is nan"),
        ("--fewest 5", "--fewest is 5, but must be from 1 to 4"),
        ("--most 3", "--most is 3, but must be at least 4"),
        ("--dagger.train-freq 2", "--dagger.* was given, but --algo ppo has no such option"),
        ("--start swap-dagger", "--start was given, but --algo ppo has no such option"),
        ("--algo dagger --set gamma=0.9", "--set was given, but --algo dagger has no such"),
        ("--task crowd", "needs --algo dagger; use it, or choose one --layout: "),
        ("--controller hover", "controller is 'hover', but must be an included agent with its"),
        ("--drones 4 4", "--drones is (4, 4) and --team is (), but they must name one or more"),
        ("--drones 2 4 --environments 3", "must be a multiple of 2, the number of teams"),
        ("--algo dagger --dagger.buffer-size 9", "--dagger.batch-size is 1024, but must be at"),
        ("--drones 4 0", "num_drones is 0"),
        ("--set-hidden 0", "--set-hidden is 0, but must be an integer of at least 1"),
    ],
)
def test_what_cannot_be_trained_is_refused(options, why, tmp_path, refused):
    assert why in refused("train", "--out", tmp_path / "run", *options.split())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--algo stable_baselines3.DQN", "DQN refuses its arguments: The algorithm only supports"),
        ("--algo sac --set policy_kwargs={'net_arch':[8]}", "is not tanh"),
    ],
)
def test_an_algorithm_that_cannot_learn_this_is_refused(options, why, tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path / "run"), *options.split()]) in (1, 2)
    assert why in capsys.readouterr().err


def test_policies_are_not_chosen_on_the_seeds_of_reports():
    chosen = set(validation_seeds(4096))
    assert all(not chosen & set(frozen_seeds(seed, 4096)) for seed in range(20))


@pytest.mark.parametrize("kind", [PPO, SAC, TD3])
@pytest.mark.parametrize("encoder", ["mlp", "deep-set"])
def test_the_network_that_flies_is_that_of_the_model(kind, encoder):
    algo = kind.__name__.lower()
    config = RlConfig(out=Path("never"), algo=algo, encoder=encoder, environments=4, drones=3)
    made = make_setting(config, "swap_v1")
    env = SharedPolicyVecEnv(made.blueprints, 4, 0, features=True)
    small = {"batch_size": 96} if algo == "ppo" else {"buffer_size": 10}
    model: Any = kind("MlpPolicy", env, **(sb3.arguments_of(made) | small))
    seen = env.reset()
    for _ in range(5):
        seen = env.step(np.random.default_rng(0).uniform(-1, 1, (12, 3)))[0]
    expected, _ = model.predict(seen, deterministic=True)
    found = np.clip(sb3.network_of(model)(seen, made.sizes), -1.0, 1.0)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    env.close()


def test_the_learning_rate_falls_in_both_stages():
    rates = [sb3.falling_rate(1.0 - done) for done in (0.0, 0.375, 0.74, 0.75, 0.875, 1.0)]
    assert [rates[k] for k in (0, 1, 3)] == pytest.approx([1e-3, 5e-4, 7e-4])
    assert rates[0] > rates[1] > rates[2] < rates[3] > rates[4] > rates[5]


def test_a_drone_that_waits_for_its_team_is_not_imitated(monkeypatch):
    monkeypatch.setattr(dagger, "NOISE", 0.5)
    config = RlConfig(
        out=Path("never"), algo="dagger", environments=8, drones=6, on_contact="end_pair",
        dagger=DaggerConfig(train_freq=100, gradient_steps=1, guided=0.0),
    )  # fmt: skip
    made = dagger.Dagger(make_setting(config, "swap_v1"))
    waits: list[int] = []
    for core in made.cores:
        fly = core.step

        def counted(actions, fly=fly):
            result = fly(actions)
            waits.append(int((~result.active).sum()))
            return result

        core.step = counted  # type: ignore[method-assign]
    made.fly(1)
    decisions = 100 * sum(core.num_envs * core.num_drones for core in made.cores)
    assert sum(waits) > 5
    assert made.buffer.filled == decisions - sum(waits)
    made.close()


@pytest.mark.slow
def test_two_drones_learn_to_swap(tmp_path):
    """By PPO in 200,000 decisions."""
    config = RlConfig(
        out=tmp_path, drones=2, steps=200_000, seed=1, num_neighbors=1, progress=False,
        evaluations=1, evaluation_episodes=64,
        set=("n_steps=16", "batch_size=1024", "n_epochs=8", "learning_rate=3e-3"),
    )  # fmt: skip
    assert sb3.train_sb3(config, "swap_v1")["last"]["random_success"] > 0.6
