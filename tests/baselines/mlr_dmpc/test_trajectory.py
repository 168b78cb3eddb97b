"""Trajectories: condensed maps against what is flown, exact minima of distances; parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from swarm_envs.baselines.mlr_dmpc.condensed_qp import condensed
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, closest_distances

CONFIGS = [
    MlrDmpcConfig(),
    MlrDmpcConfig(horizon_rounds=8, collision_sampling_s=0.05),
    MlrDmpcConfig(input_sampling_s=0.1, state_sampling_s=0.2),
]


def plan_of(config: MlrDmpcConfig, seed: int) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(3, 3)).astype(np.float32).astype(float)
    fixed = condensed(config)
    z = rng.normal(size=(len(fixed.gradient), 3))
    jerk = fixed.jerks.at(state, z)
    plan = Trajectory(Identity(1, 0), state, jerk, config.input_sampling_s)
    return plan, state, z


@pytest.mark.parametrize("config", CONFIGS)
def test_maps_give_what_the_trajectory_flies(config):
    plan, state, z = plan_of(config, 0)
    fixed = condensed(config)
    positions = plan.positions(fixed.collision_times)
    assert np.allclose(fixed.positions.at(state, z), positions, atol=1e-5)
    flown = np.vstack([*np.moveaxis(plan.states(fixed.state_times), 1, 0), plan.jerk])
    assert np.allclose(fixed.bounded.at(state, z), flown, atol=1e-5)


@pytest.mark.parametrize("config", CONFIGS)
def test_the_cost_is_what_the_parameters_say(config):
    """Half the squared length plus the gradient, against the weights summed over the plan."""
    fixed, target = condensed(config), np.array([0.3, -0.2, 1.0])
    _, state, z = plan_of(config, 2)

    def cost(z: np.ndarray) -> float:
        jerk = fixed.jerks.at(state, z)
        flown = Trajectory(Identity(0, 0), state, jerk, config.input_sampling_s)
        times = config.input_sampling_s * np.arange(1, config.num_inputs + 1)
        p, v, a = np.moveaxis(flown.states(times), 1, 0)
        total = config.path_weight * np.square(p - target).sum()
        total += config.position_weight * np.square(p[-1] - target).sum()
        total += config.velocity_weight * np.square(v).sum()
        total += config.acceleration_weight * np.square(a).sum()
        return float(total + config.jerk_weight * np.square(flown.jerk).sum())

    def condensed_cost(z: np.ndarray) -> float:
        offset = state - np.array([target, np.zeros(3), np.zeros(3)])
        return float(np.square(z).sum() / 2 + np.sum((fixed.gradient @ offset) * z))

    other = np.zeros_like(z)
    difference = cost(z) - cost(other)
    assert condensed_cost(z) - condensed_cost(other) == pytest.approx(difference, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("collision_sampling_s", 0.15, "divide"),
        ("input_sampling_s", 0.07, "divide"),
        ("input_sampling_s", 2e-313, "divide round_s, 0.2 s, into at most 1000 parts"),
        ("box", ((0.0, 0.0, 0.0), (1.0, -1.0, 1.0)), "corners"),
    ],
)
def test_impossible_parameters_are_refused(name, value, said):
    with pytest.raises(ValueError, match=rf"{name} is .*{said}"):
        MlrDmpcConfig(**{name: value})


SHRINK = np.array([1.0, 1.0, 1.0 / 6.0])


def test_exact_minima_agree_with_fine_sampling_and_a_search_around_the_least():
    rng = np.random.default_rng(0)
    rounds, drones, dt = 30, 5, 0.2
    states = rng.normal(size=(rounds, drones, 3, 3))
    jerks = 5 * rng.normal(size=(rounds, drones, 3))
    found = closest_distances(states, jerks, dt, SHRINK)
    assert np.isinf(np.diag(found)).all()
    t = np.linspace(0.0, dt, 4001)[:, None, None, None]
    p, v, a = np.moveaxis(states, 2, 0)
    paths = (p + t * (v + t * (a / 2 + t * jerks / 6))) * SHRINK
    for i in range(drones):
        for j in range(i):
            fine = np.linalg.norm(paths[:, :, i] - paths[:, :, j], axis=-1)
            at, piece = (int(k) for k in np.unravel_index(np.argmin(fine), fine.shape))

            def gap(time: float, i: int = i, j: int = j, piece: int = piece) -> float:
                one, two = (
                    [p, v, a / 2, jerk / 6]
                    for p, v, a, jerk in ((*states[piece, k], jerks[piece, k]) for k in (i, j))
                )
                powers = time ** np.arange(4)
                return float(np.linalg.norm((powers @ np.subtract(one, two)) * SHRINK))

            near = t[max(at - 1, 0)].item(), t[min(at + 1, 4000)].item()
            least = minimize_scalar(gap, bounds=near, method="bounded", options={"xatol": 1e-10})
            assert found[i, j] == pytest.approx(min(least.fun, fine.min()), abs=1e-9)


def test_who_is_not_in_the_air_is_close_to_nobody():
    states = np.zeros((2, 2, 3, 3))
    states[0, 1] = np.nan
    states[1, 1, 0, 0] = 3.0
    assert closest_distances(states, np.zeros((2, 2, 3)), 0.2, SHRINK)[0, 1] == 3.0
