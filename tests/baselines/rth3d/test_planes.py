"""Planes between robots against the nearest point of a hull, found face by face."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from swarm_envs.baselines.rth3d.flight.smooth import bezier_points, planes_between
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight
from swarm_envs.state import FloatArray


def nearest_to_zero(points: FloatArray) -> FloatArray:
    """Of the hull of points (4, 3): the nearest of all faces' own points that lie in them."""
    found = []
    for size in range(1, 5):
        for chosen in itertools.combinations(points, size):
            corner, edges = chosen[0], np.array(chosen[1:]).reshape(-1, 3) - chosen[0]
            share = np.linalg.lstsq(edges.T, -corner, rcond=None)[0]
            if (share >= 0.0).all() and share.sum() <= 1.0:
                found.append(corner + share @ edges)
    return min(found, key=lambda point: float(point @ point))


def wandering(seed: int) -> SplineFlight:
    """Three robots that move about places 0.6 m from each other."""
    rng = np.random.default_rng(seed)
    places = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.6, 0.3]])
    inner = places + rng.uniform(-0.25, 0.25, (4, 3, 3))
    control = np.concatenate([[places] * 3, inner, [places + 0.05] * 3])
    return SplineFlight(control, 0.5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scaling", [(1.0, 1.0, 1.0), (1.0, 1.0, 2.5)])
def test_planes_stand_where_two_robots_are_nearest(seed, scaling):
    flight, distance, theta = wandering(seed), 0.55, np.array(scaling)
    planes = planes_between(flight, distance, theta, 10.0)  # so far that everyone could meet
    points, half = bezier_points(flight) / theta, len(planes.robot) // 2
    assert half == 3 * flight.num_steps
    held = np.einsum("pkx,px->pk", bezier_points(flight)[planes.step, planes.robot], planes.normal)
    assert (held >= planes.offset - 1e-7).all()  # the flight as it is satisfies all
    kept = 0
    for k in range(half):
        step, a, b = planes.step[k], planes.robot[k], planes.robot[half + k]
        way = nearest_to_zero(points[step, a] - points[step, b])
        apart = float(np.linalg.norm(way))
        np.testing.assert_allclose(planes.normal[k] * theta, way / apart, atol=1e-4)
        between = planes.offset[k] + planes.offset[half + k]
        np.testing.assert_allclose(between, min(distance, apart), atol=1e-6)
        kept += int(apart < distance)
    assert 0 < kept < half  # some are nearer than the distance, and keep what they have


def test_robots_that_touch_have_no_plane():
    places = np.zeros((7, 2, 3))
    with pytest.raises(ValueError, match="two robots of this flight touch: no plane separates"):
        planes_between(SplineFlight(places, 0.5), 0.3, np.ones(3), 0.2)
