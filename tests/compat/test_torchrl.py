"""TorchRL flies every task: its own check of specs, and rollouts that are our flights."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

from swarm_envs import TASKS, swap_v1

pytest.importorskip("torchrl", reason="run by `make test-compat`")

from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.envs.utils import check_env_specs

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]
OPTIONS: dict[str, Any] = {"num_drones": 3, "physics": "batch", "horizon_s": 1.0}


@pytest.mark.parametrize("observation", ["flat", "dict"])
@pytest.mark.parametrize("task", TASKS)
def test_specs(task, observation):
    make = importlib.import_module(f"swarm_envs.{task}").parallel_env
    env = PettingZooWrapper(env=make(observation=observation, **OPTIONS), return_state=True)
    check_env_specs(env)
    assert env.group_map == {"drone": ["drone_0", "drone_1", "drone_2"]}
    assert env.rollout(100)["drone", "action"].shape[1:] == (3, 3)


def test_turns():
    """The AEC interface, in which each drone is a group and all but one are masked."""
    env = PettingZooWrapper(env=swap_v1.env(**OPTIONS), use_mask=True)
    check_env_specs(env)


def test_drones_that_ended_are_masked():
    """Random drones fall one after another; each is masked from the step after its end on."""
    env = PettingZooWrapper(
        env=swap_v1.parallel_env(**OPTIONS | {"action": "rotors"}, on_contact="end_pair"),
        use_mask=True,
        done_on_any=False,
    )
    check_env_specs(env)
    flight = env.rollout(200)
    ended, mask = flight["next", "drone", "terminated"][..., 0], flight["next", "drone", "mask"]
    assert ended.any() and not mask.all()
    assert not flight["next", "drone", "reward"][1:][~mask[:-1]].any()


def test_a_rollout_is_our_flight():
    env = PettingZooWrapper(env=swap_v1.parallel_env(**OPTIONS), return_state=True)
    flight = env.rollout(200, auto_reset=False, tensordict=env.reset(seed=5))
    ours = swap_v1.parallel_env(**OPTIONS)
    rows, _ = ours.reset(seed=5)
    for step in range(len(flight)):
        frame = flight[step]
        assert np.array_equal(frame["drone", "observation"], np.stack(list(rows.values())))
        actions = dict(zip(ours.agents, frame["drone", "action"].numpy(), strict=True))
        rows, rewards, ended, cut, _ = ours.step(actions)
        after = frame["next"]
        assert np.array_equal(after["drone", "observation"], np.stack(list(rows.values())))
        assert np.array_equal(after["state"], ours.state())
        given = np.array(list(rewards.values()), np.float32)
        assert np.array_equal(after["drone", "reward"][:, 0], given)
        assert after["drone", "terminated"].all() == ended["drone_0"]
        assert after["drone", "truncated"].all() == cut["drone_0"]
    assert not ours.agents  # both flew until the end
