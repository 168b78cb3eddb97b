"""What policies are told where there is a reference, against plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest

from swarm_envs import ring_v0
from swarm_envs.agents.feature_sets import FEATURE_SETS, REFERENCE
from swarm_envs.envs.observation import observation_layout


@pytest.mark.parametrize("neighbors", [0, 1, 4, 5])
def test_reference_features_are_what_is_said_of_them(neighbors):
    env = ring_v0.parallel_env(num_drones=5, physics="batch", num_neighbors=neighbors)
    rng, rows = np.random.default_rng(0), list[np.ndarray]()
    env.reset(seed=0)
    while env.agents and len(rows) < 60:
        rows += list(env.step({a: rng.uniform(-1, 1, 3) for a in env.agents})[0].values())
    env.close()
    sizes, make = FEATURE_SETS[REFERENCE]
    made = make(np.stack(rows), neighbors)
    assert made.shape == (len(rows), sizes(neighbors).width)
    assert made.dtype == np.float32
    for row, got in zip(rows, made, strict=True):
        np.testing.assert_allclose(got, _by_hand(row, neighbors), rtol=1e-5, atol=1e-6)


def _by_hand(row: np.ndarray, neighbors: int) -> list[float]:
    """In the units of the layout: positions m, velocities m/s, accelerations m/s^2."""
    said = {f.name: f.scale * row[f.where].astype(float) for f in observation_layout(neighbors)}
    error, velocity = said["task.reference_position"], said["self.velocity"]
    far = math.dist(error, [0, 0, 0])
    told = [*(error / 0.2 if far < 0.2 else error / far), far]
    told += [*((said["task.reference_velocity"] - velocity) / 0.5)]
    told += [*said["task.reference_velocity"], *said["task.reference_acceleration"]]
    told += [*said["self.attitude"].reshape(3, 3)[:, 2], *said["self.thrust"]]
    told += [*((said["self.setpoint_offset"] - error) / 0.2), *said["self.type"]]
    for k in range(neighbors):
        mask = float(said[f"neighbor_{k}.mask"][0])
        x, y, z = said[f"neighbor_{k}.position"]
        beside = math.exp(-math.hypot(x, y) / 0.2)
        one = [x, y, z, *(said[f"neighbor_{k}.velocity"] / 2), beside]
        one += [beside * min(max(z / 0.5, -1), 1), *said[f"neighbor_{k}.type"], mask]
        told += [mask * value for value in one]
    return told


def test_rows_of_another_width_are_refused():
    with pytest.raises(ValueError, match="num_neighbors=2 and num_obstacles=0 have"):
        FEATURE_SETS[REFERENCE].make(np.zeros((3, 7), np.float32), 2)
