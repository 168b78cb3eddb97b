"""DAgger: who teaches where, what is remembered, and that a short training imitates."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs import swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.envs.observation import observation_layout, observation_width
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training.rl import teachers
from swarm_envs.training.rl.dagger import DaggerLearner, fewer_neighbors, teacher_of
from swarm_envs.training.rl.recipes import choosing_seeds, evaluate_policy
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig
from swarm_envs.training.rl.run import policy_note

OPTIONS: dict[str, Any] = {
    **{"out": Path("never"), "algo": "dagger", "encoder": "deep-set", "pooling": "max-sum"},
    **{"activation": "relu", "decision_rate": 20, "threads": 1, "interactions": "none"},
}


def learner(**given: Any) -> DaggerLearner:
    return DaggerLearner(RlConfig(**{**OPTIONS, **given}), "swap_v1")


@pytest.mark.parametrize(
    ("part", "drones", "name"),
    [("random", 4, "a"), ("circle", 4, "b"), ("random", 16, "c"), ("circle", 16, "d.py:A")],
)
def test_the_last_teacher_that_fits_teaches(part, drones, name):
    assert teacher_of(("a", "circle=b", "16=c", "circle,16=d.py:A"), part, drones) == name


def test_where_nobody_teaches_is_named():
    with pytest.raises(ValueError, match="none teaches 4 drones in 'random'; first name one"):
        teacher_of(("circle=a", "16=b"), "random", 4)


@pytest.mark.parametrize(
    ("name", "why"),
    [("detour", "by act_batch"), ("tracking", "by act_batch"), ("swap-ppo", "has no view|teams")],
)
def test_who_cannot_teach_is_refused(name, why):
    with pytest.raises(ValueError, match=why):
        learner(drones=8, environments=8, dagger=DaggerConfig(teacher=(name,)))


def test_a_teacher_says_what_the_agent_does_of_the_neighbours_that_it_sees():
    """In an environment that observes nine neighbours; the weight says whom others concern."""
    made = learner(drones=8, environments=8, num_neighbors=9)
    core, agent = made.env.cores[0], load("roundabout")
    assert core.config.num_neighbors == 9
    core.reset(list(range(core.num_envs)))
    env = SwarmParallelEnv(core.task, replace(core.config, **agent.requires))
    rows = []
    for e in range(core.num_envs):
        observations, _ = env.reset(seed=e)
        agent.reset(env, e)
        rows.append(np.stack(list(agent.act(observations, None).values())))
    wanted, weight = made._teachers[0].labels(core.rows, 3.0)
    np.testing.assert_allclose(wanted, np.clip(rows, -1.0, 1.0), atol=1e-6)
    assert set(np.unique(weight)) == {1.0, 3.0}


def test_the_teacher_of_the_shipped_policy_swaps_without_near_misses():
    name = str(Path(teachers.__file__)) + ":wide_roundabout"
    agent = load(name)
    env = swap_v1.parallel_env(num_drones=12, physics="batch", **agent.requires)
    episodes = [episode["metrics"] for episode in evaluate_agent(env, agent, frozen_seeds(4, 12))]
    assert all(m["success"] and not m["near_misses"] for m in episodes)


def test_fewer_neighbours_are_the_nearest():
    rows = np.arange(observation_width(5), dtype=np.float32)[None]
    fewer = fewer_neighbors(rows, 5, 2)[0]
    there = {f.name: rows[0, f.where] for f in observation_layout(5)}
    for field in observation_layout(2):
        assert np.array_equal(fewer[field.where], there[field.name]), field.name


def test_every_part_has_its_share_of_environments_and_the_latest_are_remembered():
    made = learner(drones=(2, 4), environments=40, dagger=DaggerConfig(buffer_size=700))
    assert [core.num_envs for core in made.env.cores] == [12, 5, 3] * 2
    assert [core.num_drones for core in made.env.cores] == [2] * 3 + [4] * 3
    for core in made.env.cores:
        core.reset(list(range(core.num_envs)))
    for _ in range(7):
        seen = np.concatenate([made._features(core) for core in made.env.cores])
        made._step(0.5)
    assert (made._filled, made._place) == (700, 7 * 120 % 700)
    last = (np.arange(120) + made._place - 120) % 700
    assert np.array_equal(made._memory["seen"][last], seen)


def test_a_short_training_imitates_where_the_straight_line_collides():
    """Four drones on a circle: without others in view all meet in the middle."""
    made = learner(layout="circle", drones=4, environments=32, steps=100_000, horizon_s=5.0)
    losses = [made.fly(segment)["loss"] for segment in made.config.segments()]
    assert losses[-1] < 0.5 * losses[0]
    agent = PolicyAgent(Policy(policy_note(made, "swap_v1"), made.actor(), {}))
    flown = {"num_drones": 4, "interactions": "none"}
    rates = evaluate_policy(agent.policy, "swap_v1", ("circle",), choosing_seeds(32), flown)
    assert rates["circle_success"] > 0.9


EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_example_of_dagger_learns():
    main = runpy.run_path(str(EXAMPLES / "dagger.py"))["main"]
    losses = main(["--steps", "12000", "--envs", "10", "--drones", "4", "--teacher", "fast-line"])
    assert np.mean(losses[-5:]) < 0.6 * losses[0]


def test_the_example_of_ppo_learns():
    main = runpy.run_path(str(EXAMPLES / "ppo.py"))["main"]
    rewards = main(["--steps", "60000", "--envs", "32", "--drones", "2"])
    assert np.mean(rewards[-5:]) > np.mean(rewards[:5]) + 0.01
