"""Derivatives of the forces: against differences, and against torch through the trained network."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner.force_jacobian import (
    difference_jacobian,
    force_jacobian,
)
from swarm_envs.interactions import load
from swarm_envs.interactions.field import LATERAL_REACH, VERTICAL_REACH, unlimited
from swarm_envs.vehicles import GRAM_FORCE, parse_team

KNOTS = 40


def swarm(robots, rng, height=1.0):
    """States (K, N, 6) of drones packed into one interaction volume."""
    position = rng.uniform([-0.3, -0.3, -0.5], [0.3, 0.3, 0.5], (KNOTS, robots, 3))
    position[..., 2] += height
    return np.concatenate((position, rng.normal(0.0, 0.5, position.shape)), axis=2)


@pytest.mark.parametrize("name", ["learned", "deep-set", "wake", "none"])
@pytest.mark.parametrize("height", [0.6, 1.5])
def test_the_jacobian_is_that_of_differences(name, height):
    model, team = load(name), parse_team("SLS*L")
    states = swarm(4, np.random.default_rng(2), height)
    for robot in range(4):
        exact = force_jacobian(model, team, states, robot)
        for step in (1e-6, 1e-4):
            rough = difference_jacobian(model, team, states, robot, step)
            near = np.isclose(exact, rough, rtol=1e-4, atol=1e-6)
            assert near.mean() > 0.98  # a kink within the step spoils a few
        assert (np.abs(exact).max() > 0.0) == (name != "none")


def test_unwindowed_and_unanchored_deep_sets_are_differentiated_too():
    model, team = load("deep-set"), parse_team("SLL")
    window = np.array([LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH, VERTICAL_REACH])
    field = model.field._replace(window=window, anchor_height=0.0)
    field = field._replace(pair_range=unlimited(6), environment_range=unlimited(4))
    plain = type(model)("plain", model.types, field)
    states = swarm(3, np.random.default_rng(3))
    exact = force_jacobian(plain, team, states, 1)
    rough = difference_jacobian(plain, team, states, 1, 1e-6)
    assert np.isclose(exact, rough, rtol=1e-4, atol=1e-6).mean() > 0.98


def test_a_drone_out_of_reach_changes_no_force_but_its_drag():
    model, team = load("learned"), parse_team("SL")
    states = swarm(2, np.random.default_rng(4), 1.5)
    states[:, 1, 0] += 2.0
    jacobian = force_jacobian(model, team, states, 1)
    assert not jacobian[:, 0].any()
    drag = -np.diag(model.field.drag[1])
    np.testing.assert_allclose(jacobian[:, 1, :, 3:], np.broadcast_to(drag, (KNOTS, 3, 3)))
    assert not jacobian[:, 1, :, :3].any()


@pytest.mark.parametrize("kind", ["deep-set", "composed"])
def test_the_jacobian_is_that_of_torch(kind, tmp_path):
    """A random network, written by the trainer and read as a model; autograd is the truth."""
    torch = pytest.importorskip("torch")
    from swarm_envs.training.force_model.composed import build
    from swarm_envs.training.force_model.export import save_network
    from swarm_envs.training.force_model.network import DeepSetSpec
    from tests.helpers.torch_swarms import swarm_force_g

    torch.manual_seed(0)
    spec = DeepSetSpec(types=("S", "L"), input_range=None, kind=kind)
    network = build(spec, torch.float64)
    network.drag[:, 2] = torch.tensor([0.01, 0.03])
    save_network(tmp_path / "random.safetensors", network)
    model, states = load(tmp_path / "random.safetensors"), swarm(3, np.random.default_rng(5), 0.7)
    moving = torch.tensor(states[:, 1], requires_grad=True)
    whole = torch.tensor(states)
    whole = torch.cat((whole[:, :1], moving[:, None], whole[:, 2:]), dim=1)
    force_g = swarm_force_g(network, whole[..., :3], whole[..., 3:], ("S", "L", "S"))
    vertical = force_g * GRAM_FORCE
    jacobian = force_jacobian(model, parse_team("SLS"), states, 1)
    rtol, atol, share = (1e-6, 1e-10, 1.0) if kind == "deep-set" else (1e-4, 1e-6, 0.98)  # kinks
    for drone in range(3):
        (truth,) = torch.autograd.grad(vertical[:, drone].sum(), moving, retain_graph=True)
        assert truth.abs().max() > 1e-4
        near = np.isclose(jacobian[:, drone, 2], truth.numpy(), rtol=rtol, atol=atol)
        assert near.mean() >= share
