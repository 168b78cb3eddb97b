"""Networks of several samples, together and in crowds: precision, nobody is lifted."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import PAIRWISE, ForceField, empty_field
from swarm_envs.interactions.network import network
from swarm_envs.interactions.packed import (
    ENVIRONMENT,
    MOST_TYPES,
    PAIRS,
    SAMPLES,
    SOURCE,
    packed,
    scratch_for,
)
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE


@pytest.mark.parametrize("name", ["learned", "deep-set"])
def test_float32_agrees_to_a_thousandth_of_a_gram(name: str) -> None:
    """1e5 random states of the flight range, against the float64 networks."""
    rng = np.random.default_rng(8)
    model = load(name)
    fast = model.with_precision("float32")
    position = rng.uniform([-0.3, -0.3, 0.05], [0.3, 0.3, 1.6], (25_000, 4, 3))
    velocity = rng.normal(0.0, 0.5, position.shape)
    expected = model.forces(position, velocity, "SLLS")
    rounded = fast.forces(position, velocity, "SLLS")
    assert 0.0 < np.abs(rounded - expected).max() < 1e-3 * GRAM_FORCE
    assert fast.with_precision("float64").field.weights.dtype == np.float64
    for still in ("none", "wake"):
        assert load(still).with_precision("float32").field is not None
    with pytest.raises(ValueError, match="unknown precision 'float16'"):
        model.with_precision("float16")


@pytest.mark.parametrize("name", ["learned", "deep-set"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_what_is_computed_together_never_shows(precision: str, name: str) -> None:
    """Other environments, and drones out of reach, do not change a bit of a drone's force."""
    model = load(name).with_precision(precision)
    rng = np.random.default_rng(9)
    position = rng.uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 1.3], (37, 3, 3))
    velocity = rng.normal(0.0, 0.3, position.shape)
    together = model.forces(position, velocity, "SLS")
    for e in range(len(position)):
        alone = model.forces(position[e : e + 1], velocity[e : e + 1], "SLS")
        np.testing.assert_array_equal(alone[0], together[e])
    far = np.concatenate([position[:, :1] + [9.0, 0.0, 0.0], position], axis=1)
    more = model.forces(far, np.concatenate([velocity[:, :1], velocity], axis=1), "LSLS")
    np.testing.assert_array_equal(more[:, 1:], together)


def field_of(rng: np.random.Generator, *networks: tuple[int, ...]) -> ForceField:
    """A pairwise sum over one type, whose two networks have these widths."""
    depth = max(map(len, networks)) - 1
    layout, flat, start = np.zeros((2, 2 * depth + 2), np.int64), [], 0
    for row, widths in zip(layout, networks, strict=True):
        row[: len(widths) + 1] = len(widths) - 1, *widths
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            row[2 + depth + k] = start
            flat.append(rng.normal(size=(inputs + 1) * outputs))
            start += len(flat[-1])
    return empty_field(1)._replace(kind=PAIRWISE, weights=np.concatenate(flat), layout=layout)


def plain(field: ForceField, n: int, x: FloatArray) -> FloatArray:
    """Network `n` of samples (S, inputs) in numpy."""
    for k in range(field.layout[n, 0]):
        inputs, outputs = field.layout[n, 1 + k : 3 + k]
        start = field.layout[n, field.layout.shape[1] // 2 + 1 + k]
        middle = start + inputs * outputs
        matrix = field.weights[start:middle].reshape(inputs, outputs)
        x = (np.maximum(x, 0.0) if k else x) @ matrix + field.weights[middle : middle + outputs]
    return x


def evaluated(field: ForceField, n: int, x: FloatArray) -> FloatArray:
    """The same by the kernel."""
    model = packed(field)
    scratch = scratch_for(model, 1, 1)
    row = model.layout[:, SOURCE].tolist().index((PAIRS, ENVIRONMENT)[n])
    samples = scratch.rows["v"].reshape(-1, scratch.rows["v"].shape[2])
    samples[: len(x), : x.shape[1]] = x
    begin = 2 * network(model.layout, row, model.weights, len(x), scratch.rows)
    return samples[begin : begin + len(x), : field.layout[n, 1 + field.layout[n, 0]]].copy()


@pytest.mark.parametrize(("number", "tolerance"), [("float64", 1e-11), ("float32", 1e-2)])
@pytest.mark.parametrize("widths", [(1,), (25, 40, 20, 1), (5, 16, 13), (100, 64, 70, 3)])
def test_a_network_of_any_size_is_the_matrix_product(
    number: str, tolerance: float, widths: tuple[int, ...]
) -> None:
    """Numbers of inputs and outputs that fill no whole row, and any number of samples."""
    rng = np.random.default_rng(10)
    field = field_of(rng, (6, *widths), (4, *widths))
    for n, inputs in enumerate((6, 4)):
        for count in (1, 2, 7, SAMPLES):
            x = rng.normal(size=(count, inputs))
            found = evaluated(field._replace(weights=field.weights.astype(number)), n, x)
            np.testing.assert_allclose(found, plain(field, n, x), rtol=1e-3, atol=tolerance)


def test_nan_goes_through_a_network() -> None:
    """As numpy's maximum has it: a ReLU must not make a force out of a broken state."""
    rng = np.random.default_rng(11)
    field, x = field_of(rng, (6, 9, 9, 1), (4, 1)), rng.normal(size=(5, 6))
    x[2, 3] = np.nan
    found = evaluated(field, 0, x)
    assert np.isnan(found[2]).all()
    assert np.isfinite(np.delete(found, 2, axis=0)).all()


def test_an_anchor_above_what_was_measured_is_brought_to_its_edge() -> None:
    """So is the drone's own height: high up, both inputs are the same, and nothing is felt."""
    model = load("learned")
    high = dataclasses.replace(model, field=model.field._replace(anchor_height=5.0))
    assert model.field.environment_range[0, 0] > -3.0
    force = high.forces([[[0.0, 0.0, 3.0]]], np.zeros((1, 1, 3)), "S")
    assert force[0, 0, 2] == 0.0
    near_the_ground = high.forces([[[0.0, 0.0, 0.1]]], np.zeros((1, 1, 3)), "S")
    assert near_the_ground[0, 0, 2] != 0.0


def test_more_types_than_there_is_room_for_are_refused() -> None:
    with pytest.raises(ValueError, match="has 9 interaction types, but must have at most 8"):
        packed(empty_field(MOST_TYPES + 1))
    with pytest.raises(ValueError, match="must be at most 128"):
        scratch_for(packed(empty_field(1)), 40, 4)


CROWDS = 40


def crowd(drones: int, speed: float, lowest: float) -> tuple[FloatArray, FloatArray]:
    """Drones all of which share one interaction volume, at rest or moving."""
    rng = np.random.default_rng([drones, int(10 * speed)])
    position = rng.uniform(0.0, 1.0, (CROWDS, drones, 3)) * [0.7, 0.7, 1.1]
    position[..., 2] += lowest
    return position, rng.uniform(-speed, speed, position.shape)


def summed_pairs(
    model: InteractionModel, position: FloatArray, velocity: FloatArray, team: str
) -> FloatArray:
    """(E, N) vertical force, g, if the neighbours' forces on a drone merely added up."""
    total = np.zeros(position.shape[:2])
    for i, own in enumerate(team):
        alone = model.forces(position[:, [i]], velocity[:, [i]], own)[:, 0, 2]
        total[:, i] = alone
        for j, other in enumerate(team):
            if j != i:
                pair = position[:, [i, j]], velocity[:, [i, j]]
                total[:, i] += model.forces(*pair, own + other)[:, 0, 2] - alone
    return total / GRAM_FORCE


@pytest.mark.parametrize("speed", [0.0, 0.7])
@pytest.mark.parametrize("kinds", ["S", "L", "SL"])
@pytest.mark.parametrize("drones", [3, 5, 8, 16])
def test_nobody_whom_pairs_push_down_is_lifted(drones: int, kinds: str, speed: float) -> None:
    model, team = load("learned"), (kinds * drones)[:drones]
    for lowest in (0.1, 0.7):
        position, velocity = crowd(drones, speed, lowest)
        force = model.forces(position, velocity, team) / GRAM_FORCE
        pairs = summed_pairs(model, position, velocity, team)
        pushed = pairs < -2.0
        assert pushed.any()
        assert not (force[..., 2][pushed] > 0.0).any()
        wake = load("wake").forces(position, velocity, team)[..., 2].mean() / GRAM_FORCE
        least, most = sorted([wake, pairs.mean()])
        assert least - 0.3 <= force[..., 2].mean() <= most + 0.3
        assert np.hypot(force[..., 0], force[..., 1]).max() < 3.0 * drones


def test_more_neighbours_never_push_less() -> None:
    model, (position, velocity) = load("learned"), crowd(8, 0.4, 0.7)
    before = model.forces(position[:, :1], velocity[:, :1], "S")[:, 0, 2]
    for count in range(2, 9):
        team = "SL" * 4
        now = model.forces(position[:, :count], velocity[:, :count], team[:count])[:, 0, 2]
        assert (now <= before + 1e-12).all()
        before = now
    assert (before < -GRAM_FORCE).any()


@pytest.mark.parametrize(("pair", "pull"), [("LL", 2.5), ("LS", 1.7), ("SS", 0.3)])
def test_the_air_pulls_towards_the_axis(pair: str, pull: float) -> None:
    """The lower drone first; means of the measured flights at 8 to 13 cm, in grams."""
    beside = np.linspace(0.08, 0.13, 6)
    position = np.zeros((6, 2, 3))
    position[:, 1, 0], position[:, :, 2] = beside, [1.0, 1.35]
    force = load("learned").forces(position, np.zeros_like(position), pair)[:, 0] / GRAM_FORCE
    assert force[:, 0].mean() == pytest.approx(pull, abs=0.6)
    np.testing.assert_allclose(force[:, 1], 0.0, atol=1e-12)
