"""Networks of forces: eq. 10 written out, torch beside compiled, symmetries, window, clip, file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    OUTER_FADE,
    DeepSetSpec,
    ForceNetwork,
    NetworkKind,
    layers,
)
from swarm_envs.training.force_model.optimisers import hold_spectral_norms
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import RANGE

KINDS: tuple[NetworkKind, ...] = ("deep-set", "pairwise", "composed")
TEAM = "SLSLS"
SPEC = DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, 0.6)


def random_network(spec: DeepSetSpec) -> ForceNetwork:
    """A float64 network with weights twice as large as at the start, so that clamps matter."""
    torch.manual_seed(0)
    made = build(spec, torch.float64)
    with torch.no_grad():
        for network in made.named_networks().values():
            for parameter in network.parameters():
                parameter.mul_(2.0)
        made.drag[0], made.drag[-1] = torch.tensor([0.01, 0.01, 0.02]), torch.tensor([0.04] * 3)
    return made


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> NetworkKind:
    return request.param


@pytest.fixture
def network(kind: NetworkKind) -> ForceNetwork:
    return random_network(dataclasses.replace(SPEC, kind=kind))


def saved(network: ForceNetwork, folder: Path) -> InteractionModel:
    save_network(folder / "model.safetensors", network, {"seed": 3})
    return load(folder / "model.safetensors")


@pytest.fixture
def model(network: ForceNetwork, tmp_path: Path) -> InteractionModel:
    return saved(network, tmp_path)


def swarm(seed: int, envs: int, drones: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.0, 1.0, (envs, drones, 3)) * [0.5, 0.5, 1.5]
    return position, rng.uniform(-2.0, 2.0, position.shape)


def torch_force_g(
    network: ForceNetwork, position: FloatArray, velocity: FloatArray, team: Sequence[str]
) -> FloatArray:
    with torch.no_grad():
        force = network.force_g(torch.from_numpy(position), torch.from_numpy(velocity), list(team))
    return np.asarray(force.numpy())


def written_out(made, position, velocity, types, i):
    """Equation 10 for one drone of one swarm, with window, clamp, anchor and drag, in numpy."""

    def perceptron(module, x):
        chain = [(m.weight.detach().numpy(), m.bias.detach().numpy()) for m in layers(module)]
        for weight, bias in chain[:-1]:
            x = np.maximum(weight @ x + bias, 0.0)
        return chain[-1][0] @ x + chain[-1][1]

    def step(r, a, b):
        u = min(max((r - a) / (b - a), 0.0), 1.0)
        return 1 - (6 * u**5 - 15 * u**4 + 10 * u**3)

    z, v = min(position[i, 2], 0.6), velocity[i]
    low, high = (np.array(side) for side in RANGE.environment)
    e = perceptron(made.phi_environment, np.clip(-np.array([z, *v]), low, high))
    reference = perceptron(made.phi_environment, np.clip(-np.array([0.6, *v]), low, high))
    low, high = (np.array(side) for side in RANGE.pair)
    h = e.copy()
    for j in range(len(types)):
        if j != i:
            x = np.concatenate([position[j] - position[i], velocity[j] - velocity[i]])
            ax, ay, az = np.abs(x[:3])
            w = step(ax, 0.25, 0.35) * step(ay, 0.25, 0.35) * step(az, 0.8, 1.1)
            h += w * perceptron(made.phi[types[j]], np.clip(x, low, high))
    rho = made.rho[types[i]]
    drag = made.drag.numpy()["SL".index(types[i]), 2] * v[2] / GRAM_FORCE
    return (perceptron(rho, h) - perceptron(rho, reference))[0] - drag


def test_force_is_equation_10_written_out():
    made, team = random_network(SPEC), ("S", "L", "L", "S")
    position, velocity = swarm(0, 6, 4)
    force = torch_force_g(made, position, velocity, team)
    for e in range(6):
        for i in range(4):
            expected = written_out(made, position[e], velocity[e], team, i)
            assert force[e, i] == pytest.approx(expected, abs=1e-11)


def test_clip_scales_down_to_the_limit_and_never_up():
    made = random_network(SPEC)
    before = [p.detach().clone() for p in made.parameters()]
    hold_spectral_norms(made.parameters(), 1.5)
    clipped = 0
    for old, new in zip(before, made.parameters(), strict=True):
        if old.ndim == 2 and np.linalg.norm(old.numpy(), 2) > 1.5:
            clipped += 1
            assert np.linalg.norm(new.detach().numpy(), 2) == pytest.approx(1.5, rel=1e-9)
            assert torch.allclose(new / new.norm(), old / old.norm())
        else:
            assert torch.equal(new, old)
    assert 0 < clipped < len([p for p in before if p.ndim == 2])


def test_file_gives_back_the_same_function(tmp_path):
    for name, spec in {
        "shipped": SPEC,
        "paper": DeepSetSpec(("S", "L"), EVERYWHERE, None, None),
        "hard": DeepSetSpec(("S", "L", "XL"), None, None, None),
        "pairwise": DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, kind="pairwise"),
    }.items():
        made = random_network(spec)
        if name in ("hard", "pairwise"):
            made = build(spec, torch.float32 if name == "hard" else torch.float64)
        save_network(tmp_path / f"{name}.safetensors", made, {"seed": 7})
        loaded = load_network(tmp_path / f"{name}.safetensors")
        assert type(loaded) is type(made) and loaded.spec == made.spec
        assert b'\\"seed\\": 7' in (tmp_path / f"{name}.safetensors").read_bytes()
        position, velocity = map(torch.from_numpy, swarm(6, 10, 3))
        force = loaded.force_g(position, velocity, "SLS")
        assert torch.equal(force, made.double().force_g(position, velocity, "SLS"))
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_missing_or_foreign_weights_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no weights file"):
        load_network(tmp_path / "none.safetensors")
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, tmp_path / "foreign.safetensors")
    with pytest.raises(ValueError, match="format None, but must have 'deep-set-1' or"):
        load_network(tmp_path / "foreign.safetensors")


@pytest.mark.parametrize("anchor", [None, 0.6])
def test_compiled_forces_are_those_of_torch(
    kind: NetworkKind, anchor: float | None, tmp_path: Path
) -> None:
    network = random_network(dataclasses.replace(SPEC, anchor_height_m=anchor, kind=kind))
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
