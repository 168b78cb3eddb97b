"""Communication between drones: neighbors within a range, late, and not always."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.training.shared_policy import SharedPolicyVecEnv

FAR = {"observe_range_m": 1e200}
"""A limit that limits nothing."""


def make(**options):
    given: dict[str, Any] = {"num_drones": 5, "layout": "random", "physics": "batch"}
    return swap_v1.parallel_env(**{**given, "observation": "dict", **options})


def fly(env, seed=3, steps=12):
    """The observations of a flight with random actions, one dictionary a decision."""
    rng = np.random.default_rng(0)
    seen = [copy.deepcopy(env.reset(seed=seed)[0])]
    for _ in range(steps):
        actions = {a: rng.uniform(-0.3, 0.3, 3).astype(np.float32) for a in env.agents}
        seen.append(copy.deepcopy(env.step(actions)[0]))
    return seen


@pytest.mark.parametrize("more", [{}, {"observe_load": True}, {"world": "hall"}])
@pytest.mark.parametrize("neighbors", [2, 7])
def test_limits_that_limit_nothing_give_the_same_bytes(more, neighbors):
    free = fly(make(num_neighbors=neighbors, team="LSSS*S", **more))
    limited = fly(make(num_neighbors=neighbors, team="LSSS*S", **more, **FAR))
    for ours, theirs in zip(free, limited, strict=True):
        for agent in ours:
            for name, part in ours[agent].items():
                assert part.tobytes() == theirs[agent][name].tobytes()


def test_neighbors_beyond_the_range_are_not_observed():
    start = [[0.0, 0, 1], [0.9, 0, 1], [1.9, 0, 1], [-1.6, 0, 1]]
    env = make(num_drones=4, observe_range_m=1.05)
    rows, _ = env.reset(seed=0, options={"start": start, "goal": start})
    found = {agent: row["mask"].tolist() for agent, row in rows.items()}
    assert found == {
        "drone_0": [1, 0, 0],
        "drone_1": [1, 1, 0],
        "drone_2": [1, 0, 0],
        "drone_3": [0, 0, 0],
    }
    np.testing.assert_allclose(rows["drone_1"]["neighbors"][:2, :3], [[-0.9, 0, 0], [1.0, 0, 0]])
    assert not rows["drone_3"]["neighbors"].any()


def test_late_neighbors_are_where_they_were_and_own_states_are_not_late():
    now, late = fly(make(**FAR)), fly(make(observe_delay_s=3 / 48))
    for step, row in enumerate(late):
        for agent, seen in row.items():
            np.testing.assert_array_equal(seen["self"], now[step][agent]["self"])
            assert seen["mask"].all() == (step >= 3)
            if step < 3:
                assert not seen["neighbors"].any()
                continue
            own, was = seen["self"][:3], now[step - 3]
            places = [row["self"][:3] - own for name, row in was.items() if name != agent]
            nearest = sorted(places, key=np.linalg.norm)[:3]
            np.testing.assert_allclose(seen["neighbors"][:, :3], nearest, atol=1e-6)


def test_delays_are_rounded_up_to_decisions_of_any_rate():
    for rate, delay_s, decisions in ((48, 0.05, 3), (48, 1 / 48, 1), (20, 0.05, 1), (10, 0.01, 1)):
        masks = [
            rows["drone_0"]["mask"].any()
            for rows in fly(make(decision_rate=rate, observe_delay_s=delay_s), steps=4)
        ]
        assert masks == [step >= decisions for step in range(5)]


def test_the_range_is_that_of_true_positions():
    start = [[0.0, 0, 1], [0.9, 0, 1], [0, 1.4, 1]]
    env = make(num_drones=3, observe_range_m=1.0, randomization="position_noise_m=0.3")
    for seed in range(20):
        rows, _ = env.reset(seed=seed, options={"start": start, "goal": start})
        assert [row["mask"].sum() for row in rows.values()] == [1, 1, 0]


def test_the_share_of_messages_that_is_lost_is_the_probability():
    env = make(num_drones=8, num_neighbors=7, observe_loss=0.3)
    masks = np.array([[row["mask"] for row in rows.values()] for rows in fly(env, steps=60)])
    n, lost = masks.size, 1.0 - masks.mean()
    assert abs(lost - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)
    per_drone = 1.0 - masks.mean(axis=(0, 2))
    assert np.ptp(per_drone) > 0.0  # each link has losses of its own
    assert not fly(make(observe_loss=1.0))[5]["drone_0"]["mask"].any()


LIMITED = {"observe_range_m": 2.5, "observe_delay_s": 2 / 48, "observe_loss": 0.2}


def test_seeds_snapshots_and_copies_reproduce_it():
    env = make(**LIMITED)
    first, again = fly(env), fly(env)
    env.reset(seed=3)
    np.testing.assert_equal(first, again)
    actions = {a: np.zeros(3, np.float32) for a in env.agents}
    for _ in range(3):
        env.step(actions)
    twin, state = copy.deepcopy(env), env.get_state()
    expected = [copy.deepcopy(env.step(actions)[0]) for _ in range(4)]
    for rows in expected:
        np.testing.assert_equal(twin.step(actions)[0], rows)
    env.set_state(state)
    for rows in expected:
        np.testing.assert_equal(env.step(actions)[0], rows)
    with pytest.raises(ValueError, match="observe_loss"):
        make(**{**LIMITED, "observe_loss": 0.1}).set_state(state)


def test_every_interface_has_it():
    options: dict[str, Any] = {"num_drones": 4, "layout": "random", **LIMITED}
    alone = swap_v1.parallel_env(**options, physics="batch")
    rows = np.array(list(alone.reset(seed=5)[0].values()))
    alone.step({a: np.zeros(3, np.float32) for a in alone.agents})
    batch: Any = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=3, threads=2, **options)
    np.testing.assert_array_equal(batch.reset(seed=[1, 2, 5])[0][2].reshape(4, -1), rows)
    team = gymnasium.make("swarm_envs/Swap-v1", physics="batch", **options)
    np.testing.assert_array_equal(team.reset(seed=5)[0].reshape(4, -1), rows)
    turns = swap_v1.env(**options, physics="batch")
    turns.reset(seed=5)
    np.testing.assert_array_equal(turns.observe("drone_2"), rows[2])
    shared = SharedPolicyVecEnv("swap_v1", 2, **options)
    shared.seed(5)
    assert shared.reset().shape == (8, rows.shape[1])


@pytest.mark.parametrize(
    ("name", "value"), [("observe_range_m", 0.0), ("observe_delay_s", -0.1), ("observe_loss", 1.5)]
)
def test_bad_limits_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        make(**{name: value})
