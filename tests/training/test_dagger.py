"""DAgger: who teaches where, what is remembered, and that a short training imitates."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs import swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training.rl import teachers
from swarm_envs.training.rl.dagger import DaggerLearner
from swarm_envs.training.rl.labels import Teacher, teacher_of
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
    ("name", "given", "why"),
    [
        ("tracking", {}, "'tracking' decides 48 times a second .* give --decision-rate 48"),
        ("air-aware", {"decision_rate": 48}, "needs another controller .* --controller air-aware"),
        ("detour", {"action": "ctbr"}, "cannot teach actions of 'ctbr': its own are 'setpoint'"),
        ("roundabout", {"action": "rotors"}, "actions of 'rotors': its own are 'acceleration'"),
        ("swap-ppo", {"decision_rate": 10}, "teams of 4 drones"),
    ],
)
def test_an_agent_that_cannot_teach_is_refused(name, given, why):
    with pytest.raises(ValueError, match=why):
        learner(drones=8, environments=8, dagger=DaggerConfig(teacher=(name,)), **given)


def test_a_teacher_says_what_the_agent_does_of_the_neighbours_that_it_sees():
    """Of a student that observes three neighbours; the weight says whom others concern."""
    made = learner(drones=8, environments=8, num_neighbors=3)
    core, agent = made.env.cores[0], load("roundabout")
    core.reset(list(range(core.num_envs)))
    env = SwarmParallelEnv(core.task, replace(core.config, **agent.requires))
    rows = []
    for e in range(core.num_envs):
        observations, _ = env.reset(seed=e)
        agent.reset(env, e)
        rows.append(np.stack(list(agent.act(observations, None).values())))
    wanted, weight = made._teachers[0].labels(core, 3.0)
    np.testing.assert_allclose(wanted, np.clip(rows, -1.0, 1.0), atol=1e-6)
    assert set(np.unique(weight)) == {1.0, 3.0}


def test_the_teacher_of_the_shipped_policy_swaps_without_near_misses():
    name = str(Path(teachers.__file__)) + ":wide_roundabout"
    agent = load(name)
    env = swap_v1.parallel_env(num_drones=12, physics="batch", **agent.requires)
    episodes = [episode["metrics"] for episode in evaluate_agent(env, agent, frozen_seeds(4, 12))]
    assert all(m["success"] and not m["near_misses"] for m in episodes)


NOISE = "position_noise_m=0.2,velocity_noise=0.5"


def core_of(task: str, **given: Any) -> tuple[SwarmCore, Any]:
    blueprint = batch_of(task, **{"threads": 1, "interactions": "none", **given})
    core = SwarmCore(blueprint.task, blueprint.config, 3)
    core.reset([5, 6, 7])
    return core, blueprint


@pytest.mark.parametrize("given", [{"randomization": NOISE}, {"world": "hall"}])
def test_labels_are_of_the_true_state(given):
    """Where students observe noise, or an estimate."""
    given = {"num_drones": 6, "num_neighbors": 7, "decision_rate": 20, **given}
    core, blueprint = core_of("swap_v1", **given)
    agent: Any = load("roundabout")
    for _ in range(5):
        core.step(np.zeros((3, 6, 3)))
    true, env = core.true_rows(7, 0, False, False), SwarmParallelEnv(*blueprint)
    agent.reset(env, 0)
    wanted, _ = Teacher("roundabout", blueprint).labels(core, 1.0)
    np.testing.assert_allclose(wanted, agent.act_batch(true), atol=1e-6)
    assert not np.allclose(wanted, agent.act_batch(core.rows), atol=1e-6)


def test_true_rows_are_what_is_observed_without_noise():
    given = {"num_drones": 6, "observe_load": True, "obstacles": "column=0:0:0.1"}
    core, _ = core_of("swap_v1", **given)
    noisy, _ = core_of("swap_v1", randomization=NOISE, **given)
    assert np.array_equal(core.rows, noisy.true_rows(3, 3, True, False))


@pytest.mark.parametrize("action", ["acceleration", "velocity"])
def test_a_privileged_script_teaches_by_its_set_points(action):
    """Labels lead the set-points along the reference, which the script follows exactly."""
    given = {"layout": "sprint", "num_drones": 6, "action": action, "decision_rate": 48}
    core, blueprint = core_of("columns_v0", world="ideal", **given)
    teacher, errors = Teacher("tracking", blueprint), []
    for _ in range(90):
        labels, weight = teacher.labels(core, 3.0)
        assert (weight == 1.0).all()
        core.step(labels)
        drones = core.world.drones
        errors.append(np.abs(drones["setpoint_position"] - drones["reference_position"]).max())
    assert max(errors) < 0.1  # the reference asks for more than 5 m/s^2
    assert errors[-1] < 0.005


def test_an_agent_with_a_memory_begins_anew_with_each_episode():
    """`detour` plans at a reset, and its plan begins at the episode's starts."""
    given = {"num_drones": 3, "action": "velocity", "decision_rate": 48, "horizon_s": 0.5}
    core, blueprint = core_of("swap_v1", **given)
    teacher = Teacher("detour", blueprint)

    def flown(*seeds: int) -> np.ndarray:
        core.reset(seeds)
        for _ in range(8):
            labels, _ = teacher.labels(core, 1.0)
            core.step(labels)
        return labels

    first, other = flown(5, 6, 7), flown(8, 9, 10)
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(flown(5, 6, 7), first)


class Core:
    """Teaches by `teach`: all drones up."""

    requires = MappingProxyType({"action": "velocity"})
    privileged = True

    def reset(self, env, seed): ...

    def act(self, observations, view): ...

    def teach(self, core):
        return np.tile([0.0, 0.0, 2.0], (core.num_envs, core.num_drones, 1))


def test_an_agent_may_label_all_environments_at_once():
    core, blueprint = core_of("swap_v1", num_drones=3, action="velocity")
    labels, _ = Teacher(f"{__file__}:Core", blueprint).labels(core, 1.0)
    assert np.array_equal(labels, np.tile([0.0, 0.0, 1.0], (3, 3, 1)))


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
