"""Networks of forces and torques: eq. 10, torch and compiled, symmetries, bounds, files."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.torque import GRAM_CENTIMETRE, load_torque
from swarm_envs.state import FloatArray
from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.examples import turned_labels
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.lipschitz import steepest
from swarm_envs.training.force_model.network import (
    EVERYWHERE,
    OUTER_FADE,
    DeepSet,
    DeepSetSpec,
    ForceNetwork,
    NetworkKind,
    layers,
)
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.spectral import hold_spectral_norms
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import RANGE, make_rows
from tests.helpers.torch_swarms import swarm_batch, swarm_force_g

KINDS: tuple[NetworkKind, ...] = ("deep-set", "composed")
TEAM = "SLSLS"
SPEC = DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, 0.6)


def random_network(spec: DeepSetSpec) -> ForceNetwork:
    """A float64 network with weights twice as large as at the start, so that clamps matter."""
    made = scaled_network(spec, 2.0)
    made.drag[0], made.drag[-1] = torch.tensor([0.01, 0.01, 0.02]), torch.tensor([0.04] * 3)
    return made


def scaled_network(spec: DeepSetSpec, scale: float) -> ForceNetwork:
    torch.manual_seed(0)
    made = build(spec, torch.float64)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(scale)
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
        state = (torch.from_numpy(position), torch.from_numpy(velocity))
        return np.asarray(swarm_force_g(network, *state, team).numpy())


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
        "single": DeepSetSpec(("S", "L", "XL"), OUTER_FADE, None, None),
    }.items():
        made = build(spec, torch.float32) if name == "single" else random_network(spec)
        save_network(tmp_path / f"{name}.safetensors", made, {"seed": 7})
        loaded = load_network(tmp_path / f"{name}.safetensors")
        assert type(loaded) is type(made) and loaded.spec == made.spec
        assert b'\\"seed\\": 7' in (tmp_path / f"{name}.safetensors").read_bytes()
        position, velocity = map(torch.from_numpy, swarm(6, 10, 3))
        force = swarm_force_g(loaded, position, velocity, "SLS")
        assert torch.equal(force, swarm_force_g(made.double(), position, velocity, "SLS"))
    assert [p.name for p in tmp_path.iterdir() if "partial" in p.name] == []


def test_missing_or_foreign_weights_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no weights file"):
        load_network(tmp_path / "none.safetensors")
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


def planted_torque(offset: FloatArray) -> FloatArray:
    """Torque (R, 3), N m: a push down at the neighbour's place, r x F, strongest near the axis."""
    push = -6.0 * GRAM_FORCE * np.exp(-np.sum(offset[:, :2] ** 2, axis=1) / 0.02)
    return 0.3 * np.cross(offset * [1.0, 1.0, 0.0], push[:, None] * [0.0, 0.0, 1.0])


def planted_rows(count: int) -> InteractionRows:
    rng = np.random.default_rng(0)
    neighbor = rng.uniform(-1.0, 1.0, (count, 1, 6)) * [0.25, 0.25, 0.1, 0.4, 0.4, 0.4]
    neighbor[..., 2] += 0.4
    torque = planted_torque(neighbor[:, 0, :3])
    force = np.zeros((count, 3))
    force[:, 2] = -8.0 * np.exp(-np.sum(neighbor[:, 0, :2] ** 2, axis=1) / 0.02)
    return make_rows(
        count,
        types=("S",),
        position=rng.uniform(0.7, 1.0, (count, 3)),
        neighbor=neighbor,
        neighbor_type=np.zeros((count, 1), dtype=np.int64),
        force_g=force,
        validation=np.arange(count) // 200 % 5 == 0,
        torque=torque,
    )


def test_a_planted_torque_is_learned_beside_the_force(tmp_path: Path) -> None:
    save_rows(tmp_path / "rows.npz", planted_rows(6000))
    config = FitConfig(
        data=tmp_path / "rows.npz", out=tmp_path, torque=True, steps=1000, batch_size=128,
        learning_rate=1e-2, offsets="none", progress=False,
    )  # fmt: skip
    report = fit(config)
    errors = report.torque_errors
    assert errors is not None
    for axis in (0, 1):
        assert errors["error_n_m"][axis] < 0.5 * errors["zero_n_m"][axis]
    assert report.findings.errors.overall < 0.3 * report.findings.errors.zero
    position = np.array([[[0.0, 0.0, 0.8], [0.1, 0.0, 1.2]], [[0.0, 0.0, 0.8], [0.0, -0.1, 1.2]]])
    model = load_torque(tmp_path / "deep-set.safetensors")
    found = model.torques(position, np.zeros_like(position), "SS")[:, 0]
    expected = planted_torque(position[:, 1] - position[:, 0])
    assert expected[0, 1] > 0.0 and expected[1, 0] > 0.0
    np.testing.assert_allclose(found, expected, atol=0.5 * np.abs(expected).max())
    force = load(tmp_path / "deep-set.safetensors").forces(position, np.zeros_like(position), "SS")
    assert force[0, 0, 2] < -2.0 * GRAM_FORCE


def test_numpy_gives_the_torque_of_torch(tmp_path: Path) -> None:
    made = scaled_network(dataclasses.replace(SPEC, torque=True), 2.0)
    save_network(tmp_path / "a.safetensors", made)
    again = load_network(tmp_path / "a.safetensors")
    assert again.spec == made.spec
    position, velocity = swarm(0, 40, 3)
    batch = swarm_batch(torch.from_numpy(position), torch.from_numpy(velocity), [0, 1, 0])
    with torch.no_grad():
        expected = again.heads(batch)
    torques = load_torque(tmp_path / "a.safetensors").torques
    torque = expected[:, 1:].numpy().reshape(40, 3, 3) * GRAM_CENTIMETRE
    assert np.abs(torque).max() > 1e-6
    np.testing.assert_allclose(torques(position, velocity, "SLS"), torque, atol=1e-15)
    force = load(tmp_path / "a.safetensors").forces(position, velocity, "SLS")[..., 2]
    np.testing.assert_allclose(force / GRAM_FORCE, expected[:, 0].reshape(40, 3), atol=1e-9)
    assert not torques(position[:, :1] + 0.6, velocity[:, :1], "L").any()


def test_a_torque_turns_with_its_row_and_changes_sign_in_a_mirror() -> None:
    rng, count = np.random.default_rng(1), 64
    lever, force = rng.normal(size=(2, count, 3))
    mirror, angle = np.where(np.arange(count) % 2, 1.0, -1.0), np.linspace(0.0, 6.0, count)
    c, s = np.cos(angle), np.sin(angle)
    turns = np.stack([mirror * c, -s, mirror * s, c], axis=1).reshape(count, 2, 2)
    label = torch.from_numpy(np.column_stack([np.ones(count), np.cross(lever, force)]))
    found = turned_labels(label, torch.from_numpy(turns))
    assert torch.equal(found[:, 0], label[:, 0])

    def polar(vector: FloatArray) -> FloatArray:
        return np.column_stack([(turns @ vector[:, :2, None])[..., 0], vector[:, 2]])

    expected = np.cross(polar(lever), polar(force))
    np.testing.assert_allclose(found[:, 1:], expected, atol=1e-12)


def test_a_table_without_torque_is_refused_where_it_is_wanted(tmp_path: Path) -> None:
    rows = planted_rows(1000)
    save_rows(tmp_path / "with.npz", rows)
    assert np.array_equal(read_rows(tmp_path / "with.npz").torque, rows.torque)  # type: ignore[arg-type]
    save_rows(tmp_path / "without.npz", dataclasses.replace(rows, torque=None))
    config = FitConfig(data=tmp_path / "without.npz", out=tmp_path, torque=True, progress=False)
    with pytest.raises(ValueError, match=r"the rows have no torque.* `torque` \(R, 3\), N m in"):
        fit(config)


def test_what_gives_no_torque_says_so(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--model composed has no torque"):
        FitConfig(data=tmp_path, out=tmp_path, model="composed", torque=True)
    made = DeepSet(DeepSetSpec(("S",), OUTER_FADE, RANGE, 0.6), torch.float64)
    save_network(tmp_path / "a.safetensors", made)
    with pytest.raises(ValueError, match="has no torque of type 'S'; fit it with --torque"):
        load_torque(tmp_path / "a.safetensors")


def test_a_network_keeps_to_the_product_of_its_spectral_norms() -> None:
    """Without window and anchor, eq. 12 bounds the slope by gamma = rho's times phi's norms."""
    network = scaled_network(DeepSetSpec(("S",), EVERYWHERE, None, None), 2.0)
    hold_spectral_norms(network.parameters(), 1.5, "exact")
    phi, _, rho = network.named_networks().values()
    bound = 1.5 ** (len(layers(phi)) + len(layers(rho)))
    found = steepest(network, 1, np.random.default_rng(1))
    assert 0.0 < found["position_gradient_g_per_m"] <= bound


def test_a_constant_force_leaves_the_slope_of_the_window() -> None:
    """A perceptron that always says 4 g: all slope is the window's, 1.875 times 4 g over 0.1 m."""
    spec = DeepSetSpec(("S",), OUTER_FADE, RANGE, None, hidden=1, layers=2)
    network = scaled_network(spec, 0.0)
    with torch.no_grad():
        layers(network.named_networks()["phi.S"])[-1].bias[0] = 4.0
        for layer in layers(network.named_networks()["rho.S"]):
            layer.weight[0, 0] = 1.0  # the identity where its input is positive
    bound = 4.0 * 1.875 * math.hypot(10.0, 10.0, 10.0 / 3.0)
    found = steepest(network, 1, np.random.default_rng(0))
    assert 0.9 * 75.0 < found["position_gradient_g_per_m"] <= bound
    assert found["input_gradient_g_per_unit"] == pytest.approx(found["position_gradient_g_per_m"])


@pytest.mark.parametrize("name", ["", "a.b", "environment", "keys"])
def test_a_type_that_cannot_be_filed_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="cannot be the name of a vehicle type"):
        DeepSetSpec(("S", name))
