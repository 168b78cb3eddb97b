"""Grid paths as flight: splines, how close they come, corridors."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.rth3d.flight import smooth as smoothing
from swarm_envs.baselines.rth3d.flight.clearance import smallest_distance, worst_clearance
from swarm_envs.baselines.rth3d.flight.smooth import (
    BEZIER,
    SmoothingConfig,
    bezier_points,
    improve,
    planes_between,
    smooth,
    smoothness,
)
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight, shortest_step
from swarm_envs.state import FloatArray

UNIT = np.ones(3)
MOVES = np.concatenate([np.zeros((1, 3), int), np.eye(3, dtype=int), -np.eye(3, dtype=int)])


def wandering_paths(n: int, side: int, steps: int, seed: int) -> np.ndarray:
    """Valid paths of robots that wander, following each other, and never exchange places."""
    rng = np.random.default_rng(seed)
    cells = rng.permutation(side**3)[:n]
    now = np.stack(np.unravel_index(cells, (side,) * 3), axis=1)
    paths = [now]
    for _ in range(steps):
        after, taken = now.copy(), {tuple(cell) for cell in now}
        for i in rng.permutation(n):
            there = now[i] + MOVES[rng.integers(len(MOVES))]
            if (there >= 0).all() and (there < side).all() and tuple(there) not in taken:
                taken.discard(tuple(now[i]))  # who moves later may follow
                taken.add(tuple(there))
                after[i] = there
        now = after
        paths.append(now)
    return np.array(paths)


def on_grid(
    paths: np.ndarray, spacing: FloatArray, origin: FloatArray, step: float
) -> SplineFlight:
    """Return the flight along paths (T + 1, n, 3) on a grid, whose steps last `step`, s."""
    points = origin + spacing * paths
    return SplineFlight(np.concatenate([points[:1]] * 2 + [points] + [points[-1:]] * 2), step)


def test_derivatives_are_those_of_the_position_and_the_ends_rest():
    flight = on_grid(wandering_paths(6, 4, 12, 0), 0.5 * UNIT, UNIT, 0.4)
    h = 1e-5
    for time in np.random.default_rng(1).uniform(0.0, flight.duration_s, 40):
        if abs(time / 0.4 - round(time / 0.4)) < 1e-3:
            continue
        before, now, after = (flight.reference(float(time + k * h)) for k in (-1, 0, 1))
        for part in range(3):
            slope = (after[part] - before[part]) / (2 * h)
            np.testing.assert_allclose(slope, now[part + 1], atol=1e-6)
    for time, place in ((-1.0, 0), (0.0, 0), (flight.duration_s, -1), (1e3, -1)):
        position, *motion = flight.reference(time)
        np.testing.assert_array_equal(position, flight.control[place])
        assert not np.any(motion)
    just = flight.reference(1e-9)
    np.testing.assert_allclose(just.position, flight.control[0], atol=1e-8)
    np.testing.assert_allclose(just.velocity, 0.0, atol=1e-6)


def test_the_worst_clearance_is_attained_and_never_undercut():
    bound = worst_clearance()
    assert 0.6 < bound < 1.0 / math.sqrt(2.0)
    first = np.array([[0, 0, 0], [-1, 0, 0], [-1, -1, 0], [0, -1, 0]])
    second = np.array([[-2, -1, 0], [-1, -1, 0], [0, -1, 0], [0, 0, 0]])
    worst = np.stack([first, second], axis=1)
    attained = smallest_distance(on_grid(worst, UNIT, 0 * UNIT, 1.0), samples=200)
    assert bound <= attained < bound + 2e-3
    for seed in range(10):
        flight = on_grid(wandering_paths(20, 4, 30, seed), UNIT, 0 * UNIT, 1.0)
        assert smallest_distance(flight, samples=10) >= bound


def test_steps_keep_the_bounds():
    spacing = np.array([0.5, 0.4, 0.7])
    step = shortest_step(spacing, 2.0, 5.0)
    for seed in range(5):
        flight = on_grid(wandering_paths(8, 3, 30, seed), spacing, UNIT, step)
        speed, acceleration, _ = flight.largest()
        assert speed <= 2.0 + 1e-12
        assert acceleration <= 5.0 + 1e-12


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_smoothing_is_faster_and_no_less_safe(rounds):
    paths, step = wandering_paths(14, 4, 12, 2), shortest_step(0.5 * UNIT, 2, 5)
    flight = on_grid(paths, 0.5 * UNIT, 0 * UNIT, step)
    house = ((0.55, 0.55, -1.0), (0.95, 0.95, 9.0))
    config = SmoothingConfig(
        distance=0.33, box=((0, 0, 0), (1.5, 1.5, 1.5)), rounds=rounds, obstacles=(house,)
    )
    before, smoother = smallest_distance(flight), smooth(flight, config)
    assert smoother.duration_s < (0.8 if rounds == 3 else 1.0) * flight.duration_s
    assert smallest_distance(smoother) >= min(before, 0.33) - 1e-4
    np.testing.assert_array_equal(smoother.control[[0, -1]], flight.control[[0, -1]])
    assert smoother.control.min() >= -1e-6
    assert smoother.control.max() <= 1.5 + 1e-6
    speed, acceleration, _ = smoother.largest()
    assert speed <= 2.0 + 1e-9
    assert acceleration <= 5.0 + 1e-9


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


@pytest.mark.parametrize("seed", range(4))
def test_planes_stand_where_two_robots_are_nearest(seed, monkeypatch):
    """Three robots move about places 0.6 m from each other."""
    monkeypatch.setattr(smoothing, "_TRAVEL_M", 10.0)  # so far that everyone could meet
    rng = np.random.default_rng(seed)
    places = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.6, 0.3]])
    inner = places + rng.uniform(-0.25, 0.25, (4, 3, 3))
    control = np.concatenate([[places] * 3, inner, [places + 0.05] * 3])
    flight, distance = SplineFlight(control, 0.5), 0.55
    planes = planes_between(flight, distance)
    points, half = bezier_points(control), len(planes.robot) // 2
    assert half == 3 * flight.num_steps
    held = np.einsum("pkx,px->pk", points[planes.step, planes.robot], planes.normal)
    assert (held >= planes.offset - 1e-7).all()  # the flight as it is satisfies all
    kept = 0
    for k in range(half):
        step, a, b = planes.step[k], planes.robot[k], planes.robot[half + k]
        way = nearest_to_zero(points[step, a] - points[step, b])
        apart = float(np.linalg.norm(way))
        np.testing.assert_allclose(planes.normal[k], way / apart, atol=1e-4)
        between = planes.offset[k] + planes.offset[half + k]
        np.testing.assert_allclose(between, min(distance, apart), atol=1e-6)
        kept += int(apart < distance)
    assert 0 < kept < half  # some are nearer than the distance, and keep what they have


def test_a_robot_s_program_is_solved_to_its_optimum():
    """Against OSQP on the whole program, all rows and bounds at once."""
    import osqp
    from scipy import sparse

    flight = on_grid(wandering_paths(14, 4, 12, 2), 0.5 * UNIT, 0 * UNIT, 0.5)
    planes = planes_between(flight, 0.33)
    count = len(flight.control)
    eye = np.eye(count)
    second, third = (np.diff(eye, n=k, axis=0) for k in (2, 3))
    hessian = np.kron(second.T @ second + third.T @ third, np.eye(3))
    for robot in range(3):
        control = flight.control[:, robot]
        own = planes.some(np.flatnonzero(planes.robot == robot))
        low, high = control - 0.2, control + 0.2
        found = improve(control, own, low[3:-3], high[3:-3], smoothness(count))
        low[:3] = high[:3] = control[:3]
        low[-3:] = high[-3:] = control[-3:]
        weights = np.zeros((len(own.step), 4, count, 3))
        for k, (step, normal) in enumerate(zip(own.step, own.normal, strict=True)):
            weights[k, :, step : step + 4] = BEZIER[:, :, None] * normal
        rows = np.vstack([weights.reshape(-1, 3 * count), np.eye(3 * count)])
        least = np.concatenate([own.offset.ravel(), low.ravel()])
        most = np.concatenate([np.full(own.offset.size, np.inf), high.ravel()])
        assert (rows @ found.ravel() >= least - 2e-6).all()
        assert (rows @ found.ravel() <= most + 2e-6).all()
        program = osqp.OSQP()
        matrices = sparse.csc_matrix(hessian), np.zeros(3 * count), sparse.csc_matrix(rows)
        options = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 200_000, "verbose": False}
        program.setup(*matrices, least, most, **options)
        best = program.solve(raise_error=False).x
        cost, reference = (x @ hessian @ x for x in (found.ravel(), best))
        assert cost == pytest.approx(reference, rel=1e-3)
        assert cost < control.ravel() @ hessian @ control.ravel()


def test_smoothing_stays_out_of_a_house():
    around = [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0)]
    paths = np.array([[(x, y, 0)] for x, y in around])
    flight = on_grid(paths, UNIT, 0 * UNIT, 1.0)
    house = ((0.8, 0.0, -1.0), (1.2, 1.2, 9.0))
    config = SmoothingConfig(distance=0.3, box=((0, 0, 0), (2, 2, 1)), obstacles=(house,))
    smoother = smooth(flight, config)
    points = [smoother.reference(t).position[0] for t in np.linspace(0, smoother.duration_s, 200)]
    gap = np.maximum(np.array(house[0]) - points, np.array(points) - house[1]).max(axis=1)
    assert gap.min() >= 0.1 - 1e-4
    free = smooth(flight, replace(config, obstacles=()))
    assert free.duration_s < smoother.duration_s


def test_what_cannot_be_flown_is_refused():
    still = np.zeros((8, 2, 3))
    for control, step_s, said in (
        (still[:3], 1.0, "at least 4"),
        (np.cumsum(still + 1.0, axis=0), 1.0, "first three control points differ"),
        (still * np.nan, 1.0, "nan"),
        (still, 0.0, "step_s is 0.0"),
    ):
        with pytest.raises(ValueError, match=said):
            SplineFlight(control, step_s)
    with pytest.raises(ValueError, match="stretch"):
        worst_clearance((1.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="no plane separates two robots of this flight"):
        planes_between(SplineFlight(np.zeros((7, 2, 3)), 0.5), 0.3)
