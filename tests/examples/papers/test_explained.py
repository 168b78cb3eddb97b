"""The share of the true force that a model explains, and the random states where it is computed."""

from __future__ import annotations

import numpy as np
import pytest

from examples.papers.neural_swarm2.explained import (
    explained_variance,
    generalisation,
    random_states,
)
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.vehicles import parse_team


def planted(scale):
    """Return the closed form with all its forces scaled by hand."""
    field = load("wake").field
    pairs, ground = field.wake_pair.copy(), field.wake_ground.copy()
    pairs[..., 0] *= scale
    ground[:, 0] *= scale
    scaled = field._replace(wake_pair=pairs, wake_ground=ground, drag=scale * field.drag)
    return InteractionModel("planted", load("wake").types, scaled)


def test_the_truth_explains_itself_and_nothing_explains_less_than_nothing():
    position, velocity = random_states("SSL", 50, np.random.default_rng(0))
    wake = load("wake")
    assert explained_variance(wake, wake, position, velocity, "SSL") == 1.0
    force = wake.forces(position, velocity, "SSL")[..., 2]
    expected = 1.0 - np.mean(force**2) / force.var()
    got = explained_variance(load("none"), wake, position, velocity, "SSL")
    assert got == pytest.approx(expected) and got < 0.0


def test_generalisation_says_each_team():
    teams = ("SS", "SSSSS", "S" * 16)
    found = generalisation(planted(0.9), load("wake"), teams, seed=3, states=30)
    assert [e["drones"] for e in found] == [2, 5, 16]
    near = [e["mean_neighbours"] for e in found]
    assert near[0] < near[1] < near[2]
    for e in found:
        assert e["rms_error_g"] == pytest.approx(0.1 * e["rms_force_g"])
        assert 0.9 < e["explained"] < 1.0
    assert found[1:] == generalisation(planted(0.9), load("wake"), teams[1:], seed=3, states=30)


def test_random_states_are_close_but_do_not_touch():
    team = "SSLS*"
    position, velocity = random_states(team, 200, np.random.default_rng(2))
    radius = np.array([vehicle.radius for vehicle in parse_team(team)])
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    apart[:, range(4), range(4)] = np.inf
    assert (apart > radius[:, None] + radius).all()
    assert (apart.min(axis=(1, 2)) < 0.7).all()
    lowest = position[..., 2].min(axis=1)
    assert lowest.min() >= 0.3 and lowest.max() <= 0.8
    assert np.quantile(np.linalg.norm(velocity, axis=-1), 0.99) < 1.0


def test_a_truth_that_never_blows_is_refused():
    position, velocity = random_states("SS", 5, np.random.default_rng(0))
    with pytest.raises(ValueError, match="must vary; give states"):
        explained_variance(load("wake"), load("none"), position, velocity, "SS")
