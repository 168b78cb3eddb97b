"""DAgger: choice of teachers, and what is imitated; networks in torch and numpy."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch

from swarm_envs import crowd_v0, swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.features import MASK, feature_sizes, features_of
from swarm_envs.agents.networks import Network
from swarm_envs.agents.policy import Policy
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.crowd import CrowdTask
from swarm_envs.training.rl import teachers
from swarm_envs.training.rl.dagger import Dagger
from swarm_envs.training.rl.encoders import Actor
from swarm_envs.training.rl.labels import Teacher, teachers_of
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig
from swarm_envs.training.rl.runs import make_setting
from swarm_envs.training.rl.validation import evaluate_policy, validation_seeds

OPTIONS: dict[str, Any] = {
    **{"out": Path("never"), "algo": "dagger", "encoder": "deep-set"},
    **{"decision_rate": 20, "threads": 1, "interactions": "none"},
}
WAY_FINDER = f"{teachers.__file__}:WayFinder"


def learner(task: str = "swap_v1", **given: Any) -> Dagger:
    return Dagger(make_setting(RlConfig(**{**OPTIONS, **given}), task))


def test_the_last_teacher_that_fits_teaches():
    taught = [("random", 4), ("circle", 4), ("random", 16), ("circle", 16)]
    teachers = ("a", "circle=b", "16=c", "circle,16=d.py:A")
    assert teachers_of(teachers, taught) == ["a", "b", "c", "d.py:A"]


def test_where_nobody_teaches_is_named():
    with pytest.raises(ValueError, match="none teaches 4 drones in 'random'; begin with"):
        teachers_of(("circle=a", "16=b"), [("random", 4)])


@pytest.mark.parametrize("idle", ["rnadom=b", "16=b", "circle,8=b"])
def test_a_teacher_of_nothing_is_named(idle):
    with pytest.raises(ValueError, match=f"has '{idle}', which teaches nothing here: the parts"):
        teachers_of(("a", idle), [("random", 4), ("circle", 4), ("random", 8)])


@pytest.mark.parametrize(
    ("name", "given", "why"),
    [
        ("tracking", {}, "'tracking' has a decision rate of 48 Hz .* give --decision-rate 48"),
        (
            "downwash-aware",
            {"decision_rate": 48},
            "needs another controller .* --controller downwash-aware",
        ),
        (
            "detour",
            {"action": "ctbr"},
            "cannot teach --action ctbr, as its own action is 'setpoint'",
        ),
        (
            "roundabout",
            {"action": "rotors"},
            "--action rotors, as its own action is 'acceleration'",
        ),
        ("pursuit-dagger", {}, "supports pursuit"),
    ],
)
def test_an_agent_that_cannot_teach_is_refused(name, given, why):
    with pytest.raises(ValueError, match=why):
        learner(drones=8, environments=8, dagger=DaggerConfig(teacher=(name,)), **given)


def test_a_teacher_says_what_the_agent_does_of_the_neighbours_that_it_sees():
    """Of a student that observes three neighbours; the weight says whom others concern."""
    made = learner(drones=8, environments=8, num_neighbors=3)
    core, agent = made.cores[0], load("roundabout")
    core.reset(list(range(core.num_envs)))
    env = SwarmParallelEnv(core.task, replace(core.config, **agent.requires))
    rows = []
    for e in range(core.num_envs):
        observations, _ = env.reset(seed=e)
        agent.reset(env, e)
        rows.append(np.stack(list(agent.act(observations, None).values())))
    wanted, weight = made.teachers[0].labels(core, 3.0)
    np.testing.assert_allclose(wanted, np.clip(rows, -1.0, 1.0), atol=1e-6)
    assert set(np.unique(weight)) == {1.0, 3.0}


def test_the_teacher_of_the_shipped_policy_swaps_without_near_misses():
    agent = load(f"{teachers.__file__}:wide_roundabout")
    env = swap_v1.parallel_env(num_drones=12, physics="batch", **agent.requires)
    episodes = [episode["metrics"] for episode in evaluate_agent(env, agent, frozen_seeds(4, 12))]
    assert all(m["success"] and not m["near_misses"] for m in episodes)


def test_the_teacher_of_circles_keeps_the_distances_at_the_start():
    agent = load(f"{teachers.__file__}:Carousel")
    env = swap_v1.parallel_env(layout="circle", num_drones=32, physics="batch", **agent.requires)
    env.reset(seed=0)
    start = env.core.world.drones["start"][0]
    nearest = np.linalg.norm(start[0] - start[1:], axis=-1).min()
    flown = [episode["metrics"] for episode in evaluate_agent(env, agent, frozen_seeds(4, 2))]
    assert all(m["success"] and m["time_to_goal_s"] < 4.0 for m in flown)
    assert all(m["minimum_separation_m"] > 0.85 * nearest for m in flown)
    env.close()


def test_the_teacher_of_crowds_reaches_more_goals_in_a_forest_than_scripts_and_hits_nothing():
    reached = {}
    for each in (WAY_FINDER, "fast-line"):
        agent = load(each)
        env = crowd_v0.parallel_env(horizon_s=10.0, physics="batch", **agent.requires)
        flown = [found["metrics"] for found in evaluate_agent(env, agent, frozen_seeds(4, 4))]
        assert all(metrics["success"] for metrics in flown)
        reached[each] = np.mean([metrics["throughput_per_min"] for metrics in flown])
        env.close()
    assert reached[WAY_FINDER] > 1.1 * reached["fast-line"]


def test_all_layouts_of_crowd_are_learned_with_short_ways_between_buildings():
    given = {"layout": "all", "drones": 8, "environments": 6, "num_neighbors": 7}
    dagger = DaggerConfig(teacher=(WAY_FINDER,))
    made = learner("crowd_v0", **given, num_obstacles=3, dagger=dagger)
    tasks = [core.tasks[0] for core in made.cores]
    reach = {t.layout: t.reach_m for t in tasks if isinstance(t, CrowdTask)}
    assert reach == {"open": (1.0, 3.0), "forest": (1.0, 3.0), "buildings": (0.8, 2.2)}


NOISE = "position_noise_m=0.2,velocity_noise=0.5"


def core_of(task: str, **given: Any) -> tuple[SwarmCore, Any]:
    blueprint = batch_of(task, **{"threads": 1, "interactions": "none", **given})
    core = SwarmCore(blueprint.task, blueprint.config, 3)
    core.reset([5, 6, 7])
    return core, blueprint


@pytest.mark.parametrize(
    "given", [{"randomization": NOISE}, {"world": "hall"}, {"observe_loss": 1.0}]
)
def test_labels_are_of_the_true_state(given):
    """Where students observe noise, an estimate, or no neighbors."""
    given = {"num_drones": 6, "num_neighbors": 7, "decision_rate": 20, **given}
    core, blueprint = core_of("swap_v1", **given)
    agent: Any = load("roundabout")
    for _ in range(5):
        core.step(np.zeros((3, 6, 3)))
    true, env = core.true_rows(7), SwarmParallelEnv(*blueprint)
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
    sizes = DaggerConfig(batch_size=64, buffer_size=700)
    made = learner(drones=(2, 4), environments=40, dagger=sizes)
    assert [core.num_envs for core in made.cores] == [12, 5, 3] * 2
    assert [core.num_drones for core in made.cores] == [2] * 3 + [4] * 3
    for core in made.cores:
        core.reset(list(range(core.num_envs)))
    made.rng, made.ends = np.random.default_rng(0), []
    for _ in range(7):
        seen = [features_of(core.rows, *core.form[1:]) for core in made.cores]
        made._decide(0.5)
    buffer = made.buffer
    assert (buffer.filled, buffer.place) == (700, 7 * 120 % 700)
    last = (np.arange(120) + buffer.place - 120) % 700
    flat = np.concatenate([rows.reshape(-1, rows.shape[-1]) for rows in seen])
    assert np.array_equal(buffer.parts[0][last], flat)


@pytest.mark.slow
def test_a_short_training_imitates_where_the_straight_line_collides():
    """Four drones on a circle: without others in view all meet in the middle."""
    made = learner(layout="circle", drones=4, environments=32, steps=100_000, horizon_s=5.0)
    losses = [made.fly(k)["loss"] for k in range(10, made.config.rollouts, 10)]
    assert losses[-1] < 0.5 * losses[0]
    policy = Policy(made.setting.note(), made.actor.network(), {})
    flown = {"num_drones": 4, "interactions": "none"}
    rates = evaluate_policy(policy, "swap_v1", ("circle",), validation_seeds(32), flown)
    assert rates["circle_success"] > 0.9


EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_example_of_dagger_learns():
    main = runpy.run_path(str(EXAMPLES / "dagger.py"))["main"]
    losses = main(["--steps", "6000", "--envs", "10", "--drones", "4", "--teacher", "fast-line"])
    assert np.mean(losses[-5:]) < 0.6 * losses[0]


def test_the_example_of_ppo_learns():
    main = runpy.run_path(str(EXAMPLES / "ppo.py"))["main"]
    rewards = main(["--steps", "30000", "--envs", "32", "--drones", "2"])
    assert np.mean(rewards[-5:]) > np.mean(rewards[:5]) + 0.01


SIZES = feature_sizes(4)
NETWORKS = {"mlp": None, "deep-set": (8, 6)}


def actor_of(kind: str, activation: str = "relu", seed: int = 1) -> Actor:
    torch.manual_seed(seed)
    return Actor(SIZES, (9, 7), 3, NETWORKS[kind], activation)


def values_of(count: int = 40) -> np.ndarray:
    """Features of drones with none to four neighbors, nearest first."""
    rng = np.random.default_rng(0)
    own, around = SIZES.split(rng.normal(size=(count, SIZES.width)).astype(np.float32))
    present = np.arange(4) < rng.integers(0, 5, (count, 1))
    around[..., MASK] = 1.0
    around *= present[..., None]
    return np.concatenate([own, around.reshape(count, -1)], axis=1)


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("kind", NETWORKS)
def test_what_flies_is_what_was_trained(kind, activation):
    actor, values = actor_of(kind, activation), values_of()
    trained = actor(torch.from_numpy(values)).detach().numpy()
    np.testing.assert_allclose(actor.network()(values, SIZES), trained, atol=2e-6)
    assert np.ptp(trained, axis=0).min() > 0.01


def test_a_set_has_no_order_and_no_places_for_who_is_not_there():
    network, values = actor_of("deep-set").network(), values_of()
    own, around = SIZES.split(values)
    turned = np.concatenate([own, around[:, ::-1].reshape(len(own), -1)], axis=1)
    np.testing.assert_allclose(network(turned, SIZES), network(values, SIZES), atol=2e-6)
    alone = np.concatenate([own, around[:, 0]], axis=1)
    around[:, 1:] = 0.0
    padded = np.concatenate([own, around.reshape(len(own), -1)], axis=1)
    single = SIZES._replace(num_neighbors=1)
    np.testing.assert_allclose(network(padded, SIZES), network(alone, single), atol=2e-6)


def test_a_policy_of_other_observations_or_decisions_begins_no_training():
    for rate, why in (
        (20, "with observe_setpoint True, but this run has F"),
        (10, "with decision_rate 20, but this run has 10"),
    ):
        with pytest.raises(ValueError, match=f"--start is 'swap-dagger' {why}"):
            learner(start="swap-dagger", num_neighbors=7, decision_rate=rate)


@pytest.mark.parametrize("kind", NETWORKS)
def test_training_begins_as_another_policy(kind):
    first: Network = actor_of(kind).network()
    second = actor_of(kind, seed=2)
    assert not np.array_equal(second.network().layers[0][0], first.layers[0][0])
    second.fill(first)
    assert np.array_equal(second.network()(values_of(), SIZES), first(values_of(), SIZES))
    with pytest.raises(ValueError, match="the policy of --start has layers"):
        Actor(SIZES, (9, 8), 3, NETWORKS[kind], "relu").fill(first)
