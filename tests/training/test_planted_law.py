"""A force law that these tests plant is found again: motion, noisy log, label, rows, fit."""

import dataclasses

import numpy as np
import pytest

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import WAKE, empty_field
from swarm_envs.training.collection import CollectionConfig, collect, interaction_rows
from swarm_envs.training.force_model import FitConfig, fit
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.vehicles import GRAM_FORCE

AMPLITUDE_G, WIDTH_M, SPREAD, DRAG = 18.0, 0.06, 0.06, 0.03

ENOUGH = 0.96
"""Of the variance of the planted law; without the motors' lag in the label it is 0.95."""

FLIGHTS = CollectionConfig(
    teams=("S", "SS"), walks=4, low_walks=0, swaps=8, low_swaps=0, duration_s=8.0, seed=11
)


def planted() -> InteractionModel:
    """One jet that widens under every small drone, and linear drag: no ground effect."""
    field = empty_field(1)._replace(kind=WAKE)
    field.wake_pair[0, 0] = AMPLITUDE_G * GRAM_FORCE, WIDTH_M, SPREAD, 1.0
    field.wake_ground[0] = 0.0, 1.0
    field.drag[0] = DRAG
    return InteractionModel("planted", ("S",), field)


def law_g(offset, velocity_z):
    """The planted vertical force, g, by hand: of a neighbour at an offset (R, 3), m."""
    width = WIDTH_M + SPREAD * np.maximum(offset[:, 2], 0.0)
    lateral = np.hypot(offset[:, 0], offset[:, 1])
    jet = WIDTH_M / width * np.exp(-0.5 * (lateral / width) ** 2)
    onset = 1.0 / (1.0 + np.exp(-offset[:, 2] / 0.03))
    return -AMPLITUDE_G * jet * onset - DRAG * velocity_z / GRAM_FORCE


def held_out_states(rng, count=600):
    """Drone 0, and a neighbour somewhere above or below it, well inside the volume."""
    lower = np.tile([0.0, 0.0, 0.9], (count, 1))
    offset = rng.uniform([-0.14, -0.14, -0.5], [0.14, 0.14, 0.5], (count, 3))
    offset[:, 2] += np.sign(offset[:, 2]) * 0.15
    position = np.stack([lower, lower + offset], axis=1)
    velocity = np.zeros((count, 2, 3))
    velocity[..., 2] = rng.uniform(-0.3, 0.3, (count, 1))
    return position, velocity, law_g(offset, velocity[:, 0, 2])


def test_the_law_by_hand_is_what_is_planted():
    position, velocity, truth = held_out_states(np.random.default_rng(0))
    force = planted().forces(position, velocity, "SS")[:, 0, 2] / GRAM_FORCE
    np.testing.assert_allclose(force, truth, atol=1e-9)
    assert truth.min() < -10.0 and truth.std() > 2.0


def test_a_planted_law_is_recovered_from_noisy_logs(tmp_path):
    """Collect, label, fit; the explained share of the planted law at held-out states."""
    flights = collect(FLIGHTS, tmp_path / "flights", progress=False, environment=planted())
    save_rows(tmp_path / "rows.npz", dataclasses.replace(interaction_rows(flights), types=("S",)))
    fit(
        FitConfig(
            data=tmp_path / "rows.npz",
            out=tmp_path / "fit",
            offsets="none",
            steps=500,
            batch_size=512,
            learning_rate=5e-3,
            slope_limit=None,
            position_jitter_m=0.0,
            velocity_jitter=0.0,
            lipschitz_samples=0,
            progress=False,
        )
    )
    model = load(tmp_path / "fit" / "learned.safetensors")
    position, velocity, truth = held_out_states(np.random.default_rng(3))
    found = model.forces(position, velocity, "SS")[:, 0, 2] / GRAM_FORCE
    assert 1.0 - np.mean((found - truth) ** 2) / truth.var() > ENOUGH
    assert model.field.drag[0] == pytest.approx(DRAG, rel=0.1)
    alone = model.forces(np.array([[[0.0, 0.0, 1.0]]]), np.zeros((1, 1, 3)), "S")
    assert (alone == 0.0).all()
