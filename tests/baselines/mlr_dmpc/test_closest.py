"""The exact minimum of distances between samples."""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.closest import closest_distances

SHRINK = np.array([1.0, 1.0, 1.0 / 6.0])


def test_two_that_fly_past_each_other_are_closest_where_geometry_says():
    states = np.zeros((1, 2, 3, 3))
    states[0, :, 0] = [[-0.013, 0.1, 1.0], [0.0, -0.05, 1.0]]
    states[0, :, 1] = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    found = closest_distances(states, np.zeros((1, 2, 3)), 0.2, SHRINK)
    assert abs(found[0, 1] - 0.15) < 1e-12 and np.isinf(np.diag(found)).all()


def test_exact_minima_agree_with_fine_sampling_and_are_never_above_it():
    rng = np.random.default_rng(0)
    rounds, drones, dt = 30, 5, 0.2
    states, jerks = (
        rng.normal(size=(rounds, drones, 3, 3)),
        5 * rng.normal(size=(rounds, drones, 3)),
    )
    found = closest_distances(states, jerks, dt, SHRINK)
    t = np.linspace(0.0, dt, 4001)[:, None, None, None]
    p, v, a = np.moveaxis(states, 2, 0)
    paths = (p + t * (v + t * (a / 2 + t * jerks / 6))) * SHRINK
    for i in range(drones):
        for j in range(i):
            fine = np.linalg.norm(paths[:, :, i] - paths[:, :, j], axis=-1).min()
            assert fine - 2e-3 * 0.2 <= found[i, j] <= fine + 1e-12


def test_who_is_not_in_the_air_is_close_to_nobody():
    states = np.zeros((2, 2, 3, 3))
    states[0, 1] = np.nan
    states[1, 1, 0, 0] = 3.0
    assert closest_distances(states, np.zeros((2, 2, 3)), 0.2, SHRINK)[0, 1] == 3.0
