"""DAgger: who teaches where, and what is imitated; encoders: sets without order, in two ways."""

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
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch.distributions import Normal, kl_divergence

from swarm_envs import crowd_v0, swap_v1
from swarm_envs.agents import fly_episode, load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.networks import ANY, Network, to_tensors
from swarm_envs.agents.policy import Policy, PolicyAgent, read_policy, write_policy
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.crowd import CrowdTask
from swarm_envs.training.rl import teachers
from swarm_envs.training.rl.dagger import DaggerLearner
from swarm_envs.training.rl.labels import Teacher, teachers_of
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import choosing_seeds, evaluate_policy
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig
from swarm_envs.training.rl.run import policy_note

OPTIONS: dict[str, Any] = {
    **{"out": Path("never"), "algo": "dagger", "encoder": "deep-set", "pooling": "max-sum"},
    **{"activation": "relu", "decision_rate": 20, "threads": 1, "interactions": "none"},
}


def learner(**given: Any) -> DaggerLearner:
    return DaggerLearner(RlConfig(**{**OPTIONS, **given}), "swap_v1")


def test_the_last_teacher_that_fits_teaches():
    taught = [("random", 4), ("circle", 4), ("random", 16), ("circle", 16)]
    teachers = ("a", "circle=b", "16=c", "circle,16=d.py:A")
    assert teachers_of(teachers, taught) == ["a", "b", "c", "d.py:A"]


def test_where_nobody_teaches_is_named():
    with pytest.raises(ValueError, match="none teaches 4 drones in 'random'; first name one"):
        teachers_of(("circle=a", "16=b"), [("random", 4)])


@pytest.mark.parametrize("idle", ["rnadom=b", "16=b", "circle,8=b"])
def test_a_teacher_of_nothing_is_named(idle):
    with pytest.raises(ValueError, match=f"has '{idle}', which teaches nothing here: the parts"):
        teachers_of(("a", idle), [("random", 4), ("circle", 4), ("random", 8)])


@pytest.mark.parametrize(
    ("name", "given", "why"),
    [
        ("tracking", {}, "'tracking' decides 48 times a second .* give --decision-rate 48"),
        ("air-aware", {"decision_rate": 48}, "needs another controller .* --controller air-aware"),
        ("detour", {"action": "ctbr"}, "cannot teach actions of 'ctbr': its own are 'setpoint'"),
        ("roundabout", {"action": "rotors"}, "actions of 'rotors': its own are 'acceleration'"),
        ("pursuit-dagger", {}, "flies pursuit"),
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


def test_the_teacher_of_circles_keeps_the_distances_at_the_start():
    agent = load(str(Path(teachers.__file__)) + ":Carousel")
    env = swap_v1.parallel_env(layout="circle", num_drones=32, physics="batch", **agent.requires)
    env.reset(seed=0)
    start = env.core.world.drones["start"][0]
    nearest = np.linalg.norm(start[0] - start[1:], axis=-1).min()
    flown = [episode["metrics"] for episode in evaluate_agent(env, agent, frozen_seeds(4, 2))]
    assert all(m["success"] and m["time_to_goal_s"] < 4.0 for m in flown)
    assert all(m["minimum_separation_m"] > 0.85 * nearest for m in flown)
    env.close()


def test_the_teacher_of_crowds_reaches_more_goals_in_a_forest_than_scripts_and_hits_nothing():
    name = str(Path(teachers.__file__)) + ":WayFinder"
    reached = {}
    for each in (name, "fast-line"):
        agent = load(each)
        env = crowd_v0.parallel_env(horizon_s=10.0, physics="batch", **agent.requires)
        flown = [found["metrics"] for found in evaluate_agent(env, agent, frozen_seeds(4, 4))]
        assert all(metrics["success"] for metrics in flown)
        reached[each] = np.mean([metrics["throughput_per_min"] for metrics in flown])
        env.close()
    assert reached[name] > 1.1 * reached["fast-line"]


def test_all_layouts_of_crowd_are_learned_with_short_ways_between_buildings():
    given = {"task": "crowd", "layout": "all", "drones": 8, "environments": 6, "num_neighbors": 7}
    teacher = str(Path(teachers.__file__)) + ":WayFinder"
    config = RlConfig(
        **{**OPTIONS, **given}, num_obstacles=3, dagger=DaggerConfig(teacher=(teacher,))
    )
    tasks = [core.tasks[0] for core in DaggerLearner(config, "crowd_v0").env.cores]
    reach = {t.layout: t.reach_m for t in tasks if isinstance(t, CrowdTask)}
    assert reach == {"open": (1.0, 3.0), "forest": (1.0, 3.0), "buildings": (0.8, 2.2)}


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
    made = learner(
        drones=(2, 4), environments=40, dagger=DaggerConfig(batch_size=64, buffer_size=700)
    )
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


SET = {"encoder": "deep-set", "num_neighbors": 4}
KINDS = {
    "sizes": {"drones": (2, 4), "num_neighbors": 3},
    "mean": {"drones": 4, **SET},
    "max": {"team": ("SSLL", "SL"), "pooling": "max", **SET},
    "max and sum": {"drones": (2, 6), "pooling": "max-sum", "activation": "relu", **SET},
    "sum of each type": {"team": ("SSLL",), "pooling": "sum", "per_type": True, **SET},
    "attention": {"drones": (2, 6), "encoder": "attention", "num_neighbors": 4},
    "attention of types": {
        **{"team": ("SSLL", "SL"), "encoder": "attention", "num_neighbors": 3},
        "activation": "relu",
    },
    "a perceptron each": {"team": ("SSLL",), "per_type": True},
}


def make(**given) -> PpoLearner:
    """A learner whose last layers are no longer small, so that actions tell networks apart."""
    options = {"environments": 4, "n_steps": 16, "batch_size": 64, "hidden": (8, 8), **given}
    config = RlConfig(out=Path("never"), interactions="none", **options)
    learner = PpoLearner(config, "swap_v1")
    with torch.no_grad():
        learner.model.policy.action_net.weight.mul_(50.0)
        learner.model.policy.action_net.bias.add_(0.1)
    return learner


def policy_of(learner: PpoLearner) -> Policy:
    return Policy(policy_note(learner, "swap_v1"), learner.actor(), {})


def saved(learner: PpoLearner, folder: Path) -> Path:
    write_policy(folder / "policy.safetensors", policy_of(learner))
    return folder


def rows_of(learner: PpoLearner) -> np.ndarray:
    """Observation rows of every drone after some decisions."""
    learner.env.reset()
    rng = np.random.default_rng(0)
    for _ in range(5):
        learner.env.step(rng.uniform(-1, 1, (learner.env.num_envs, 3)))
    rows = [core.rows for core in learner.env.cores]
    return np.concatenate([row.reshape(-1, row.shape[-1]) for row in rows])


@pytest.mark.parametrize("kind", KINDS)
def test_what_flies_is_what_was_trained(kind, tmp_path):
    learner = make(**KINDS[kind])
    agent = PolicyAgent(read_policy(saved(learner, tmp_path) / "policy.safetensors"))
    rows = rows_of(learner)
    actions, _ = learner.model.predict(learner.env.observe(rows), deterministic=True)
    np.testing.assert_allclose(agent.act_batch(rows), actions, atol=2e-6)
    assert np.ptp(actions, axis=0).min() > 0.01
    options = {**learner.config.teams[0], "physics": "batch", "interactions": "none"}
    env = swap_v1.parallel_env(**options, horizon_s=0.5, **agent.requires)
    assert fly_episode(env, agent, seed=0)["length_s"] > 0


SETS = [kind for kind, options in KINDS.items() if "encoder" in options]


@pytest.mark.parametrize("kind", SETS)
def test_the_order_of_neighbours_changes_nothing(kind):
    learner = make(**KINDS[kind])
    sizes = learner.sizes
    values = learner.env.observe(rows_of(learner))
    own, around = sizes.split(values)
    swapped = np.concatenate([own, around[:, ::-1].reshape(len(own), -1)], axis=1)
    assert not np.array_equal(swapped, values)
    for network in learner.actor().values():
        np.testing.assert_allclose(network(swapped, sizes), network(values, sizes), atol=2e-6)
    before, after = (
        learner.model.policy.predict_values(torch.from_numpy(v)).detach().numpy()
        for v in (values, swapped)
    )
    np.testing.assert_allclose(after, before, atol=2e-6)


@pytest.mark.parametrize("kind", SETS)
def test_who_is_not_there_is_not_in_the_set(kind):
    """Slots with one neighbour act as one slot with the same neighbour, and none as none."""
    learner = make(**KINDS[kind])
    sizes, network = learner.sizes, next(iter(learner.actor().values()))
    values = learner.env.observe(rows_of(learner))
    own, around = sizes.split(values)
    alone = np.concatenate([own, around[:, 0]], axis=1)
    around[:, 1:] = 0.0
    padded = np.concatenate([own, around.reshape(len(own), -1)], axis=1)
    np.testing.assert_allclose(
        network(padded, sizes), network(alone, sizes._replace(num_neighbors=1)), atol=2e-6
    )
    nobody = np.concatenate([own, np.zeros_like(around).reshape(len(own), -1)], axis=1)
    none = sizes._replace(num_neighbors=0)
    np.testing.assert_allclose(network(nobody, sizes), network(own, none), atol=2e-6)


def test_every_type_flies_by_a_network_of_its_own():
    """Whose network is broken shows in who acts otherwise; a phi that is broken, likewise."""
    learner = make(**KINDS["sum of each type"])
    networks, sizes = learner.actor(), learner.sizes
    rows = rows_of(learner)
    large = learner.env.observe(rows)[:, sizes.own_column("L")] == 1.0
    assert large.mean() == 0.5

    def changed(other: dict[str, Network]) -> np.ndarray:
        note = policy_note(learner, "swap_v1")
        first, second = (PolicyAgent(Policy(note, n, {})) for n in (networks, other))
        return (first.act_batch(rows) != second.act_batch(rows)).any(axis=1)

    mute = tuple((weight, bias + 0.3) for weight, bias in networks["L"].layers)
    assert np.array_equal(changed({**networks, "L": replace(networks["L"], layers=mute)}), large)
    blind = tuple((0.0 * weight, bias) for weight, bias in networks["S"].phi or ())
    assert np.array_equal(changed({**networks, "S": replace(networks["S"], phi=blind)}), ~large)


@pytest.mark.parametrize("encoder", ["mlp", "deep-set", "attention"])
@pytest.mark.parametrize("algo", ["mappo", "sac"])
def test_every_algorithm_has_every_encoder(algo, encoder):
    """The network that flies gives the means that are trained; SAC's through a tanh."""
    options: dict[str, Any] = {} if algo == "sac" else {"batch_size": 64, "n_steps": 16}
    options |= {"algo": algo, "encoder": encoder, "interactions": "none", "hidden": (8, 8)}
    config = RlConfig(out=Path("never"), environments=4, **options)
    learner: Any = make_learner(config, "swap_v1")
    values = learner.env.observe(rows_of(learner))
    seen = torch.from_numpy(values)
    policy = learner.network()
    sac = algo == "sac"
    means = policy.actor.get_action_dist_params(seen)[0].tanh() if sac else policy.means(seen)
    found = learner.actor()[ANY](values, learner.sizes)
    np.testing.assert_allclose(found, means.detach().numpy(), atol=2e-6)


@pytest.mark.parametrize("algo", ["mappo", "dagger"])
def test_other_algorithms_begin_as_another_policy_too(algo, tmp_path):
    first = make(drones=4, **SET)
    start = str(saved(first, tmp_path))
    options: dict[str, Any] = {"algo": algo, "start": start, "hidden": (8, 8), **SET}
    options |= {"batch_size": 64, "n_steps": 16} if algo == "mappo" else {}
    config = RlConfig(out=Path("never"), environments=12, interactions="none", **options)
    found = to_tensors(make_learner(config, "swap_v1").actor())
    for name, tensor in to_tensors(first.actor()).items():
        assert np.array_equal(found[name], tensor), name


@pytest.mark.parametrize("algo", ["ppo", "mappo"])
def test_a_policy_begins_as_another_and_is_drawn_back_to_it(tmp_path, algo):
    """By the gradient of the divergence of normal distributions of the same deviation."""
    first = make(drones=4, **SET)
    start = {"algo": algo, "start": str(saved(first, tmp_path)), "start_kl": 3.0}
    config = replace(first.config, seed=9, **start)
    learner: Any = make_learner(config, "swap_v1")
    values = learner.env.reset()
    before = first.model.predict(values[:, : first.sizes.width], deterministic=True)[0]
    np.testing.assert_allclose(learner.model.predict(values, deterministic=True)[0], before)
    model, seen = learner.model, torch.from_numpy(values)
    with torch.no_grad():
        model.policy.action_net.bias += 0.2
        means = model.policy.means(seen)
    zeros = torch.zeros(len(values))
    batch = RolloutBufferSamples(seen, means + 0.1, zeros, zeros, zeros, zeros)
    found = []
    for model.start_kl in (0.0, 3.0):
        model.policy.log_std.grad = torch.zeros(3)
        found.append([model._loss_gradient(means, batch)[0], model.policy.log_std.grad])
    at, log_std = means.clone().requires_grad_(), model.policy.log_std.detach().requires_grad_()
    away = kl_divergence(Normal(at, log_std.exp()), Normal(means - 0.2, log_std.exp()))
    (3.0 * away.sum(-1).mean()).backward()
    for k, wanted in enumerate((at.grad, log_std.grad)):
        torch.testing.assert_close(found[1][k] - found[0][k], wanted, atol=1e-6, rtol=1e-4)
    with pytest.raises(ValueError, match="the policy to start from has networks"):
        make(drones=4, start=str(tmp_path))


def test_two_types_learn_apart():
    """What only large drones have flown changes their network, and not the small ones'."""
    learner = make(team=("SSLL",), per_type=True)
    policy = learner.model.policy
    values = torch.from_numpy(learner.env.observe(rows_of(learner)))
    large = values[:, learner.sizes.own_column("L")] == 1.0
    small_before = policy.get_distribution(values[~large]).mode().detach()
    optimiser = torch.optim.SGD(policy.pi_features_extractor.parameters(), lr=0.1)
    policy.get_distribution(values[large]).mode().square().sum().backward()
    optimiser.step()
    assert torch.equal(policy.get_distribution(values[~large]).mode(), small_before)


def test_types_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="--per-type needs vehicles of several types"):
        make(per_type=True)
    learner = make(team=("SSLL",), per_type=True)
    agent = PolicyAgent(policy_of(learner))
    options = {"team": "SSSS*", "physics": "batch", "interactions": "none", **agent.requires}
    env = swap_v1.parallel_env(**options)
    with pytest.raises(ValueError, match=r"trained for vehicles S, L, but the team has S\*"):
        fly_episode(env, agent, seed=0)
