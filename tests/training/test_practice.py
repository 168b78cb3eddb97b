"""What swaps are learned from: starts harder than the task's, weights that change in a run."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import Blueprint
from swarm_envs.swap_v0 import blueprint
from swarm_envs.training import SharedPolicyVecEnv
from swarm_envs.training.rl.starts import PracticeSwap
from swarm_envs.vehicles import parse_team


def test_episodes_are_of_every_kind_as_often_as_is_said():
    task, rng = PracticeSwap(team=parse_team("SSSS")), np.random.default_rng(0)
    circles = crowds = 0
    for _ in range(1000):
        placement = task.place(rng)
        start, goal = placement.start, placement.goals[0]
        order = [int(np.linalg.norm(start - g, axis=1).argmin()) for g in goal]
        np.testing.assert_allclose(start[order], goal, atol=1e-12)
        assert all(order[i] != i for i in range(4))
        circles += bool(np.ptp(start[:, 2]) == 0)
        crowds += bool(np.ptp(start[:, 2]) > 0 and np.ptp(start, axis=0).max() <= 1.6)
    assert circles == pytest.approx(250, abs=45)
    # Four points of the random box, 3.4 m wide, lie within 1.6 m in x and in y by chance too: with
    # r = 1.6 / 3.4 it happens in a share of (4 r^3 - 3 r^4)^2 = 0.07.
    assert crowds == pytest.approx(500 + 0.07 * 250, abs=50)


def test_crowded_episodes_are_apart_and_half_of_them_pairs():
    task = PracticeSwap(team=parse_team("SSSS"), circle_share=0.0, crowded_share=1.0)
    rng, pairs = np.random.default_rng(1), 0
    for _ in range(400):
        placement = task.place(rng)
        start, goal = placement.start, placement.goals[0]
        gaps = np.linalg.norm(start[:, None] - start[None], axis=-1)[np.triu_indices(4, 1)]
        assert gaps.min() >= 0.35
        order = [int(np.linalg.norm(start - g, axis=1).argmin()) for g in goal]
        pairs += all(order[order[i]] == i for i in range(4))
    # of the nine derangements of four, three are pairs too
    assert pairs / 400 == pytest.approx(0.5 + 0.5 * 3 / 9, abs=0.08)


def test_given_starts_and_lone_drones_are_not_practised():
    start = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    placement = PracticeSwap(team=parse_team("SS")).place(np.random.default_rng(0), start)
    assert np.array_equal(placement.start, start)
    assert len(PracticeSwap(team=parse_team("S")).place(np.random.default_rng(0)).start) == 1


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"circle_share": 0.6}, "sum to at most 1"),
        ({"pairs_share": 1.5}, "pairs_share is 1.5"),
        ({"layout": "circle"}, "needs layout='random'"),
        ({"crowded_side_m": (0.05, 1.0)}, "crowded_side_m"),
    ],
)
def test_impossible_practice_is_refused(options, why):
    with pytest.raises(ValueError, match=why):
        PracticeSwap(team=parse_team("SSSS"), **options)


def test_an_environment_flies_a_blueprint_and_takes_no_options_beside():
    found = blueprint(num_drones=3, physics="batch", horizon_s=0.5)
    task = PracticeSwap(team=found.task.team)
    env = SharedPolicyVecEnv(Blueprint(task, found.config), num_envs=2, seed=0)
    assert env.core.task is task
    assert env.reset().shape[0] == 6
    env.close()
    with pytest.raises(TypeError, match=r"num_drones: give options to the blueprint"):
        SharedPolicyVecEnv(found, num_drones=3)


def test_rewards_follow_new_weights():
    """The same flight, weighed otherwise: rewards differ by what the term's weight changed."""
    found = blueprint(num_drones=2, physics="batch", layout="circle")
    core, action = SwarmCore(found.task, found.config), np.full((1, 2, 3), 0.3)
    core.reset([0])
    before = core.step(action)
    core.set_reward_weights({"effort": -2.0})
    core.reset([0])
    after = core.step(action)
    place = core.task.reward_names.index("effort")
    changed = (-2.0 - core.task.reward_weights["effort"]) * before.reward_terms[place]
    np.testing.assert_allclose(after.rewards - before.rewards, changed, atol=1e-15)
    with pytest.raises(ValueError, match="did you mean 'effort'"):
        core.set_reward_weights({"efort": 1.0})
    core.close()
