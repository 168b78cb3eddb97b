"""Interaction models: symmetries, far fields, and two implementations of the deep set."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.forces import write_forces
from swarm_envs.vehicles import GRAM_FORCE, VEHICLES, Vehicle

MODELS = ("wake", "learned", "deep-set")


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> InteractionModel:
    return load(request.param)


def swarm() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    position = rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 1.6], (2, 3, 3))
    return position, rng.normal(0.0, 0.3, position.shape)


def test_none_is_nothing() -> None:
    assert not load("none").forces(*swarm(), "SLS").any()


@pytest.mark.parametrize("team", ["S", "L", "S*"])
def test_a_lone_drone_at_rest_aloft_feels_nothing(model: InteractionModel, team: str) -> None:
    position = [[[0.3, -0.2, height]] for height in (0.6, 0.8, 1.0, 2.0)]
    force = model.forces(position, np.zeros((4, 1, 3)), team)
    assert np.abs(force).max() < 0.3 * GRAM_FORCE


def test_drag_opposes_motion(model: InteractionModel) -> None:
    velocity = np.array([[[0.5, 0.0, 0.0]], [[0.0, -0.5, 0.0]]])
    force = model.forces(np.full((2, 1, 3), 1.0), velocity, "S")
    assert force[0, 0, 0] <= 0.0
    assert force[1, 0, 1] >= 0.0
    np.testing.assert_allclose(force[0, 0, 1:], 0.0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_force_fades_to_nothing_at_the_edge_without_a_step(
    model: InteractionModel, axis: int
) -> None:
    """Walking a neighbour out of the volume, no millimetre changes the force by a gram."""
    reach = [0.35, 0.35, 1.1][axis]
    offsets = np.arange(0.0, reach + 0.02, 1e-3)
    position = np.zeros((len(offsets), 2, 3))
    position[..., 2] = 1.5
    position[:, 1, 2] += 0.0 if axis == 2 else 0.4
    position[:, 1, axis] += offsets
    if axis == 2:
        position, offsets = position[200:], offsets[200:]
    force = model.forces(position, np.zeros_like(position), "SL")[:, 0, 2] / GRAM_FORCE
    np.testing.assert_allclose(force[offsets >= reach], 0.0, atol=1e-12)
    if model.name != "wake":  # anchored: without neighbours it is a difference of equals
        assert not force[offsets >= reach].any()
    assert np.abs(np.diff(force)).max() < 0.4  # 400 g/m over a millimetre
    assert abs(force[np.searchsorted(offsets, reach - 2e-3)]) < 0.05


def test_downwash_pushes_the_lower_drone_only(model: InteractionModel) -> None:
    for team in ("SS", "LS", "SL", "LL"):
        position = np.array([[[0.0, 0.0, 1.4], [0.0, 0.0, 1.1]]])
        upper, lower = model.forces(position, np.zeros_like(position), team)[0, :, 2] / GRAM_FORCE
        assert lower < -5.0, team
        assert abs(upper) < 2.5, team


def test_ground_effect_lifts(model: InteractionModel) -> None:
    heights = np.array([[[0.0, 0.0, 0.08]], [[0.0, 0.0, 0.12]], [[0.0, 0.0, 0.6]]])
    for team in ("S", "L"):
        low, middle, high = model.forces(heights, np.zeros_like(heights), team)[:, 0, 2]
        assert low > middle > high - 0.3 * GRAM_FORCE
        assert low > 1.0 * GRAM_FORCE


def test_inputs_are_clamped_to_what_was_measured() -> None:
    model = load("learned")
    fast, faster = np.zeros((2, 1, 2, 3))
    fast[0, 0, 0], faster[0, 0, 0] = 50.0, 90.0
    position = np.array([[[0.0, 0.0, 1.3], [0.0, 0.0, 1.0]]])
    a, b = (model.forces(position, v, "SS")[0, 1, 2] for v in (fast, faster))
    assert a == pytest.approx(b, abs=1e-12) and abs(a) < 30 * GRAM_FORCE


def test_read_only_arrays_compile_no_kernel_more() -> None:
    model, (position, velocity) = load("wake"), swarm()
    kernel: Any = write_forces
    writable = model.forces(position, velocity, "SLS")
    before = len(kernel.signatures)
    for array in (position, velocity):
        array.setflags(write=False)
    assert np.array_equal(model.forces(position, velocity, "SLS"), writable)
    assert len(kernel.signatures) == before


def test_what_no_model_can_take() -> None:
    learned, zero = load("learned"), np.zeros((1, 1, 3))
    with pytest.raises(ValueError, match=r"position has shape \(2, 3\)"):
        learned.forces(np.zeros((2, 3)), np.zeros((2, 3)), "SS")
    with pytest.raises(ValueError, match="velocity is nan"):
        learned.forces(zero, np.full((1, 1, 3), np.nan), "S")
    odd = Vehicle(**{**vars(VEHICLES["S"]), "interaction_type": "XL"})
    with pytest.raises(ValueError, match=r"interaction type 'XL'.*valid: 'L', 'S'"):
        learned.forces(zero, zero, [odd])
