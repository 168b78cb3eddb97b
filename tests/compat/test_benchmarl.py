"""BenchMARL's grid over our tasks, by the example: continuous and discrete actions."""

from __future__ import annotations

import numpy as np
import pytest

import swarm_envs

pytest.importorskip("benchmarl", reason="run by `make test-compat`")

from examples import benchmarl_grid

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


def grid(out, *algorithms: str) -> dict[tuple[str, str], list[float]]:
    size = ["--steps", "96", "--envs", "2", "--out", str(out)]
    return benchmarl_grid.main(["--algorithms", *algorithms, *size])


def test_every_kind_of_algorithm_trains(tmp_path, monkeypatch):
    monkeypatch.setitem(benchmarl_grid.OPTIONS, "horizon_s", 1.0)
    found = grid(tmp_path, "ippo", "masac", "qmix", "vdn")
    assert {name for _, name in found} == {"ippo", "masac", "qmix", "vdn"}
    assert all(len(returns) == 1 and np.isfinite(returns[0]) for returns in found.values())


@pytest.mark.parametrize("on_contact", ["end_team", "end_pair"])
def test_teams_whose_drones_fall_one_after_another(tmp_path, monkeypatch, on_contact):
    for name, value in {"action": "rotors", "on_contact": on_contact, "num_drones": 3}.items():
        monkeypatch.setitem(benchmarl_grid.OPTIONS, name, value)
    ((task, _), returns), *others = grid(tmp_path, "mappo").items()
    assert task == "swap_v1" and np.isfinite(returns).all() and not others


def test_a_direction_is_the_largest_action_along_an_axis():
    plain, wrapped = (swarm_envs.make("swap_v1", **benchmarl_grid.OPTIONS) for _ in range(2))
    env = benchmarl_grid.Directions(wrapped)
    for each in (plain, env):
        each.reset(seed=3)
    for number, axis in ((0, None), (2, 1), (6, 2)):
        action = np.zeros(3, np.float32)
        if axis is not None:
            action[axis] = 1.0 if number < 4 else -1.0
        seen = plain.step(dict.fromkeys(plain.agents, action))[0]
        found = env.step(dict.fromkeys(env.agents, number))[0]
        assert all(np.array_equal(found[agent], row) for agent, row in seen.items())
