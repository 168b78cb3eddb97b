"""Many environments at once: each is the single one with the same seed, to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs.envs.core import StepResult, SwarmCore
from swarm_envs.envs.options import blueprint_of
from swarm_envs.envs.randomization import Randomization
from tests.helpers.living import living

SEEDS = (3, 15, 92)
STEPS = 120


CASES: list[tuple[str, dict[str, Any]]] = [
    ("swap_v1", {"team": "LSS*"}),
    ("swap_v1", {"team": "LSS*", "action": "rotors"}),
    ("swap_v1", {"num_drones": 3, "layout": "circle"}),
    ("swap_v1", {"num_drones": 3, "layout": "stacked"}),
    ("ring_v1", {"horizon_s": 2.0}),
    ("formation_v1", {"num_drones": 4, "shape_s": 0.5, "travel_s": 0.4}),
    ("formation_v1", {"num_drones": 4, "labels": "random", "shape_s": 0.5, "travel_s": 0.4}),
    ("crowd_v0", {"num_drones": 4, "layout": "open", "horizon_s": 2.0}),
    ("pursuit_v0", {"num_drones": 4, "layout": "chase", "horizon_s": 2.0}),
    ("gates_v0", {"num_drones": 2, "radius_m": 0.4, "horizon_s": 2.0}),
]
"""Every kind of episode: task and options."""


def cores(
    engine: str, num_envs: int, team: str = "LSS*", task: str = "swap_v1", **options: Any
) -> SwarmCore:
    if task == "swap_v1" and "num_drones" not in options:
        options["team"] = team
    return SwarmCore(*blueprint_of(task, physics=engine, **options)[:2], num_envs)


def check_results(one: StepResult, many: StepResult, e: int) -> None:
    np.testing.assert_array_equal(one.observations[0], many.observations[e])
    np.testing.assert_array_equal(one.rewards[0], many.rewards[e])
    np.testing.assert_array_equal(one.reward_terms[:, 0], many.reward_terms[:, e])
    assert one.terminated[0] == many.terminated[e]
    assert one.truncated[0] == many.truncated[e]


@pytest.mark.parametrize(("task", "options"), CASES)
def test_each_environment_of_a_batch_is_the_single_one(engine, task, options):
    """With resets of those that end, each by itself, going on with its own generator."""
    many = cores(engine, len(SEEDS), task=task, **options)
    ones = [cores(engine, 1, task=task, **options) for _ in SEEDS]
    rows = many.reset(SEEDS).copy()
    for e, (one, seed) in enumerate(zip(ones, SEEDS, strict=True)):
        np.testing.assert_array_equal(one.reset([seed])[0], rows[e])
    rng, resets = np.random.default_rng(0), 0
    for _ in range(STEPS):
        actions = rng.uniform(-1, 1, (len(SEEDS), many.num_drones, many.mode.width))
        result = many.step(actions)
        batch = living(many)
        for e, one in enumerate(ones):
            check_results(one.step(actions[e : e + 1]), result, e)
            for name, single in living(one).items():
                if single[0].tobytes() != batch[name][e].tobytes():  # equal bytes are found sooner
                    np.testing.assert_array_equal(single[0], batch[name][e], name)
        over = result.terminated | result.truncated
        np.testing.assert_array_equal(over, ~many.running)
        if over.any():
            rows = many.reset(mask=over).copy()
            for e in np.flatnonzero(over).tolist():
                np.testing.assert_array_equal(ones[e].reset()[0], rows[e])
                resets += 1
    assert resets >= 2
    together = many.metrics_of([2, 0])
    assert together == [many.metrics(2), many.metrics(0)] and together[0] != together[1]
    for e, one in enumerate(ones):
        assert one.metrics() == many.metrics(e)
        one.close()
    many.close()


@pytest.mark.parametrize("action", ["velocity", "ctbr"])
def test_an_environment_begins_as_one_that_never_flew(engine, action):
    options: dict[str, Any] = {"action": action, "randomization": Randomization()}
    used, fresh = (cores(engine, 2, "SS", **options) for _ in range(2))
    used.reset([1, 2])
    for _ in range(80):
        used.step(np.full((2, 2, used.mode.width), -0.9))
    assert used.world.drones["crashed"].any()
    used.reset([3, 4])
    fresh.reset([3, 4])
    kept = "drones.wrench"  # written before it is read
    arrays, expected = living(used), living(fresh)
    for name in expected.keys() - {kept}:
        np.testing.assert_array_equal(arrays[name], expected[name], name)
    used.close()
    fresh.close()


def test_ended_environments_stay_as_they_ended():
    core = cores("batch", 2, horizon_s=1.0)
    core.reset([1, 2])
    core.step(np.zeros((2, 3, 3)))
    core.reset([7, None], mask=np.array([True, False]))  # the second is one decision ahead
    for _ in range(47):
        result = core.step(np.zeros((2, 3, 3)))
    assert result.truncated.tolist() == [False, True]
    assert core.running.tolist() == [True, False]
    ended = living(core)
    result = core.step(np.full((2, 3, 3), 0.5))
    for name, now in living(core).items():
        np.testing.assert_array_equal(now[1], ended[name][1], name)
    assert result.rewards[1].tolist() == [0.0, 0.0, 0.0]
    assert result.rewards[0].any()


def test_layout_of_memory_does_not_matter():
    """Compiled entries take C order: other arrays must be brought into it."""
    results = []
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, (2, 3, 3))
    frozen = actions.copy()
    frozen.flags.writeable = False
    for given in (actions, np.asfortranarray(actions), frozen, actions.tolist()):
        core = cores("batch", 2)
        core.reset([1, 2])
        results.append([core.step(given).observations.copy() for _ in range(2)])
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])


@pytest.mark.parametrize("force_rate", [120, 48, 24])
def test_force_is_held_between_its_evaluations(force_rate):
    """In between it is the same array; at its rate it is the model's at the state before."""
    core = cores("batch", 1, layout="stacked", decision_rate=240, force_rate=force_rate)
    core.reset([1])
    hold, forces = 240 // force_rate, []
    for k in range(4 * hold):
        state = core.physics.state.copy()
        core.step(np.zeros((1, 3, 3)))
        forces.append(core.physics.force.copy())
        model = core.physics.interactions
        if k % hold == 0:
            now = model.forces(state.position, state.velocity, "LSS*")
            np.testing.assert_allclose(forces[-1], now, atol=1e-15)
        else:
            np.testing.assert_array_equal(forces[-1], forces[-2])
