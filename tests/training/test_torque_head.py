"""A deep set that gives the torque too: planted torques, symmetries, numpy beside torch."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.interactions import load
from swarm_envs.interactions.torque import GRAM_CENTIMETRE, load_torque
from swarm_envs.state import FloatArray
from swarm_envs.training.flight_logs.fit_data import read_data
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.force_model.examples import turned_labels
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.network import OUTER_FADE, DeepSet, DeepSetSpec, swarm_batch
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import RANGE, make_rows


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
        learning_rate=1e-2, offsets="none", slope_limit=None, position_jitter_m=0.0,
        velocity_jitter=0.0, lipschitz_samples=0, progress=False,
    )  # fmt: skip
    report = fit(config)
    errors = report.torque_errors
    assert errors is not None
    for axis in (0, 1):
        assert errors["error_n_m"][axis] < 0.5 * errors["zero_n_m"][axis]
    assert report.findings.errors.overall < 0.3 * report.findings.errors.zero
    position = np.array([[[0.0, 0.0, 0.8], [0.1, 0.0, 1.2]], [[0.0, 0.0, 0.8], [0.0, -0.1, 1.2]]])
    model = load_torque(tmp_path / "learned.safetensors")
    found = model.torques(position, np.zeros_like(position), "SS")[:, 0]
    expected = planted_torque(position[:, 1] - position[:, 0])
    assert expected[0, 1] > 0.0 and expected[1, 0] > 0.0
    np.testing.assert_allclose(found, expected, atol=0.5 * np.abs(expected).max())
    force = load(tmp_path / "learned.safetensors").forces(position, np.zeros_like(position), "SS")
    assert force[0, 0, 2] < -2.0 * GRAM_FORCE


def test_numpy_gives_the_torque_of_torch(tmp_path: Path) -> None:
    torch.manual_seed(0)
    made = DeepSet(DeepSetSpec(("S", "L"), OUTER_FADE, RANGE, 0.6, torque=True), torch.float64)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(2.0)
    save_network(tmp_path / "a.safetensors", made)
    again = load_network(tmp_path / "a.safetensors")
    assert again.spec == made.spec
    rng = np.random.default_rng(0)
    position = rng.uniform(0.05, 1.0, (40, 3, 3)) * [0.5, 0.5, 1.5]
    velocity = rng.uniform(-1.0, 1.0, position.shape)
    batch = swarm_batch(torch.from_numpy(position), torch.from_numpy(velocity), [0, 1, 0])
    with torch.no_grad():
        expected = again.heads(batch)
    found = load_torque(tmp_path / "a.safetensors").torques(position, velocity, "SLS")
    torque = expected[:, 1:].numpy().reshape(40, 3, 3) * GRAM_CENTIMETRE
    assert np.abs(torque).max() > 1e-6
    np.testing.assert_allclose(found, torque, atol=1e-15)
    force = load(tmp_path / "a.safetensors").forces(position, velocity, "SLS")[..., 2]
    np.testing.assert_allclose(force / GRAM_FORCE, expected[:, 0].reshape(40, 3), atol=1e-9)
    lone = load_torque(tmp_path / "a.safetensors").torques(
        position[:, :1] + 0.6, velocity[:, :1], "L"
    )
    assert not lone.any()


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


def test_tables_without_torque_are_refused_where_it_is_wanted(tmp_path: Path) -> None:
    rows = planted_rows(1000)
    save_rows(tmp_path / "with.npz", rows)
    assert np.array_equal(read_rows(tmp_path / "with.npz").torque, rows.torque)  # type: ignore[arg-type]
    elsewhere = rows.position + np.array([0.5, 0.0, 0.0])  # the same rows would be a copy
    bare = dataclasses.replace(rows, torque=None, position=elsewhere)
    save_rows(tmp_path / "without.npz", bare)
    found, report = read_data(tmp_path, LogOptions(), offsets=False, torque=True)
    assert found.torque is not None and len(found) == 1000
    assert report.files[1].refused is not None
    assert "no torque; add an array `torque` (R, 3), N m" in report.files[1].refused
    with pytest.raises(ValueError, match=r"^without\.npz: a torque head is wanted, but the table"):
        read_data(tmp_path / "without.npz", LogOptions(), offsets=False, torque=True)
    both, _ = read_data(tmp_path, LogOptions(), offsets=False)
    assert both.torque is None and len(both) == 2000


def test_what_gives_no_torque_says_so(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--model pairwise gives no torque"):
        FitConfig(data=tmp_path, out=tmp_path, model="pairwise", torque=True)
    made = DeepSet(DeepSetSpec(("S",), OUTER_FADE, RANGE, 0.6), torch.float64)
    save_network(tmp_path / "a.safetensors", made)
    with pytest.raises(ValueError, match="has no torque of type 'S'; fit it with --torque"):
        load_torque(tmp_path / "a.safetensors")
