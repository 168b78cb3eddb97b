"""Deep set, pairwise sum, composed model, in torch and compiled: what must not change forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.export import save_network
from swarm_envs.training.force_model.network import (
    OUTER_FADE,
    DeepSetSpec,
    ForceNetwork,
    NetworkKind,
)
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import RANGE

KINDS: tuple[NetworkKind, ...] = ("deep-set", "pairwise", "composed")
TEAM = "SLSLS"


def random_network(kind: NetworkKind, anchor: float | None = 0.6) -> ForceNetwork:
    """A float64 network with weights twice as large as at the start, so that clamps matter."""
    torch.manual_seed(0)
    made = build(DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, anchor, kind=kind), torch.float64)
    with torch.no_grad():
        for network in made.named_networks().values():
            for parameter in network.parameters():
                parameter.mul_(2.0)
        made.drag[0], made.drag[1] = torch.tensor([0.01, 0.01, 0.02]), torch.tensor([0.04] * 3)
    return made


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> NetworkKind:
    return request.param


@pytest.fixture
def network(kind: NetworkKind) -> ForceNetwork:
    return random_network(kind)


def saved(network: ForceNetwork, folder: Path) -> InteractionModel:
    save_network(folder / "model.safetensors", network, {"seed": 3})
    return load(folder / "model.safetensors")


@pytest.fixture
def model(network: ForceNetwork, tmp_path: Path) -> InteractionModel:
    return saved(network, tmp_path)


def swarm(seed: int, envs: int, drones: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.05, 1.0, (envs, drones, 3)) * [0.5, 0.5, 1.5]
    return position, rng.uniform(-1.5, 1.5, position.shape)


def torch_force_g(
    network: ForceNetwork, position: FloatArray, velocity: FloatArray, team: str
) -> FloatArray:
    with torch.no_grad():
        force = network.force_g(torch.from_numpy(position), torch.from_numpy(velocity), list(team))
    return np.asarray(force.numpy())


@pytest.mark.parametrize("anchor", [None, 0.6])
def test_compiled_forces_are_those_of_torch(
    kind: NetworkKind, anchor: float | None, tmp_path: Path
) -> None:
    network = random_network(kind, anchor)
    model = saved(network, tmp_path)
    for seed, team in enumerate(("S", "SL", "LLS", TEAM, "SL" * 13)):
        position, velocity = swarm(seed, 30, len(team))
        compiled = model.forces(position, velocity, team)[..., 2] / GRAM_FORCE
        expected = torch_force_g(network, position, velocity, team)
        assert np.abs(expected).max() > 0.1
        np.testing.assert_allclose(compiled, expected, atol=1e-9, rtol=0)


@pytest.mark.parametrize("offset", [(0.351, 0.0, 0.0), (0.0, -0.36, 0.2), (0.1, 0.1, 1.11)])
def test_a_neighbour_outside_the_volume_does_not_matter(
    offset: tuple[float, ...], network: ForceNetwork, model: InteractionModel
) -> None:
    position, velocity = swarm(11, 20, 2)
    position[:, 1] = position[:, 0] + [0.1, 0.0, 0.3]
    beyond = np.maximum(*position.swapaxes(0, 1)) if min(offset) >= 0.0 else position.min(axis=1)
    far = np.concatenate([position, (beyond + offset)[:, None]], axis=1)
    moving = np.concatenate([velocity, np.full((20, 1, 3), 0.7)], axis=1)
    force = torch_force_g(network, position, velocity, "SL")
    assert np.array_equal(torch_force_g(network, far, moving, "SLL")[:, :2], force)
    compiled = model.forces(position, velocity, "SL")
    assert np.array_equal(model.forces(far, moving, "SLL")[:, :2], compiled)
    near = far.copy()
    near[:, 2] = position[:, 0] + [0.0, 0.05, 0.4]
    assert not np.array_equal(model.forces(near, moving, "SLL")[:, :2], compiled)


def test_a_lone_drone_aloft_feels_drag_alone(model: InteractionModel) -> None:
    velocity = np.array([[[0.3, -0.2, 0.5]]])
    force = model.forces([[[0.0, 0.0, 0.8]]], velocity, "L")
    np.testing.assert_allclose(force, -0.04 * velocity, rtol=1e-6)


@pytest.mark.parametrize("name", ["", "a.b", "environment", "keys"])
def test_a_type_that_cannot_be_filed_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="cannot name a vehicle type"):
        DeepSetSpec(("S", name))
