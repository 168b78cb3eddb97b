"""Forces do not depend on the order of drones; those of `learned` turn with the swarm."""

from __future__ import annotations

from functools import partial
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from swarm_envs import reference
from swarm_envs.interactions import load
from swarm_envs.reference_numbers import aerodynamics_of
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE

TEAM = "SLSLS"
MODELS = {"wake": reference.wake, "learned": reference.learned, "deep-set": reference.deep_set}


def swarm(drones: int, lowest: float, speed: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Positions, m, and velocities, m/s, (count, drones, 3), all in one interaction volume."""
    rng = np.random.default_rng(drones)
    position = rng.uniform([-0.3, -0.3, lowest], [0.3, 0.3, lowest + 1.1], (count, drones, 3))
    return position, rng.normal(0.0, speed, position.shape)


def ways(model: str, team: str) -> list[Any]:
    """The compiled model and its equations, as functions of positions and velocities."""
    return [
        lambda p, v: load(model).forces(p, v, team),
        partial(MODELS[model], air=aerodynamics_of(model, team)),
    ]


@pytest.mark.parametrize("model", MODELS)
def test_drones_of_one_type_may_change_places(model: str) -> None:
    """Theorem 4 of Neural-Swarm2: forces are functions of sets of neighbors of each type."""
    position, velocity = swarm(len(TEAM), 0.1, 0.5, 50)
    small = [i for i, token in enumerate(TEAM) if token == "S"]
    for forces in ways(model, TEAM):
        force = forces(position, velocity)
        assert np.abs(force).max() > 0.05
        for order in permutations(small):
            places = np.arange(len(TEAM))
            places[small], places[[1, 3]] = order, [3, 1]
            changed = forces(position[:, places], velocity[:, places])
            np.testing.assert_allclose(changed, force[:, places], rtol=0, atol=1e-12)
        # Between types it is another swarm.
        places = np.array([1, 0, 2, 3, 4])
        changed = forces(position[:, places], velocity[:, places])
        assert np.abs(changed - force[:, places]).max() > 0.01


def turned(vector: FloatArray, angle: float, mirror: bool) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return vector @ (matrix @ np.diag([1.0, -1.0 if mirror else 1.0, 1.0])).T


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize(
    ("model", "team", "lowest", "least_g", "most_g"),
    [
        ("learned", "SL", 0.6, 0.0, 1e-9),
        ("learned", "SLLS", 0.05, 0.0, 1e-9),
        ("wake", "SL", 0.6, 0.3, 1.0),
        ("deep-set", "SL", 0.6, 10.0, 25.0),
    ],
)
def test_forces_turn_with_the_swarm(
    model: str, team: str, lowest: float, least_g: float, most_g: float, mirror: bool
) -> None:
    """Those of `learned` do; by how much others do not, docs/forces.md says."""
    position, velocity = swarm(len(team), lowest, 0.3, 10_000 // len(team))
    for forces in ways(model, team):
        force, worst = forces(position, velocity), 0.0
        assert np.abs(force[..., :2]).max() > 1e-3
        for angle in (0.4, 1.3, 2.2, 3.9):
            p, v = turned(position, angle, mirror), turned(velocity, angle, mirror)
            off = forces(p, v) - turned(force, angle, mirror)
            worst = max(worst, float(np.abs(off[..., 2]).max()) / GRAM_FORCE)
            if model == "learned":
                np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-12)
        assert least_g <= worst < most_g
