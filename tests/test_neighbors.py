"""Neighbours found by sweeping are those that looking at every pair finds, in the same order."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm_envs.interactions import load
from swarm_envs.interactions.field import default_window, empty_field
from swarm_envs.interactions.forces import find_pairs, pair_weight
from swarm_envs.interactions.packed import order_for, packed, scratch_for
from swarm_envs.neighbors import FEW, nearest, nearest_sorted, sort_along_x
from swarm_envs.state import IntArray
from swarm_envs.tables import new_world
from swarm_envs.vehicles import parse_team

Array = npt.NDArray[np.float64]

MANY = 2 * FEW


def cloud(seed: int, drones: int, side: float, ties: bool) -> Array:
    """Positions (N, 3) in a cube, m; with ties on a coarse grid, so that many are equal."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.1, side, (drones, 3))
    return np.round(position / 0.3) * 0.3 if ties else position


swarms = st.builds(
    cloud, st.integers(0, 10**6), st.integers(2, MANY), st.floats(0.5, 5.0), st.booleans()
)


def pairs_of(position: Array, drones: int) -> tuple[IntArray, Array]:
    field, places = packed(empty_field(1)), len(position) // drones
    scratch = scratch_for(field, places, drones)
    order = order_for(places, drones)
    order[0] = np.random.default_rng(1).permuted(order[0].reshape(places, -1), axis=1).ravel()
    scratch.drones["position"] = position
    find_pairs(field, places, drones, order if drones > FEW else None, scratch)
    found = scratch.pairs[: scratch.counters["pairs"][0]]
    return np.stack([found["i"], found["j"]]), found["weight"]


@given(swarms, st.integers(0, 2**31))
def test_order_is_that_of_x_whatever_it_was(position: Array, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(position))
    sort_along_x(position, order)
    np.testing.assert_array_equal(order, np.lexsort((np.arange(len(position)), position[:, 0])))


@given(swarms)
def test_pairs_are_all_with_a_weight_and_neighbours_ascend(position: Array) -> None:
    n, window = len(position), default_window()
    expected = {
        (i, j): left
        for i in range(n)
        for j in range(n)
        if i != j and (left := pair_weight(window, *(position[j] - position[i]))) > 0.0
    }
    pairs, weight = pairs_of(position, n)
    found = list(zip(*pairs.tolist(), strict=True))
    assert dict(zip(found, weight.tolist(), strict=True)) == expected
    assert len(found) == len(expected)
    for i in range(n):
        assert (np.diff(pairs[1, pairs[0] == i]) > 0).all()


@given(swarms, st.integers(0, 6))
def test_nearest_are_those_of_a_full_sort(position: Array, wanted: int) -> None:
    n = len(position)
    order, team = np.arange(n), new_world(1, n).drones[0]
    team["active"] = flies = np.random.default_rng(n).random(n) < 0.7
    sort_along_x(position, order)
    for place, i in enumerate(order.tolist()):
        apart = position - position[i]
        square = apart[:, 0] ** 2 + apart[:, 1] ** 2 + apart[:, 2] ** 2
        by_distance = np.lexsort((np.arange(n), square)).tolist()
        expected = [j for j in by_distance if j != i and flies[j]][:wanted]
        for swept in (False, True):
            found, squares = np.full(wanted, -9), np.zeros(wanted)
            if swept:
                count = nearest_sorted(i, place, position, team, order, found, squares)
            else:
                count = nearest(i, position, team, found, squares)
            assert count == len(expected)
            assert found[: len(expected)].tolist() == expected
            np.testing.assert_array_equal(squares[: len(expected)], square[expected])


@pytest.mark.parametrize("name", ["wake", "learned"])
def test_far_apart_a_large_swarm_feels_what_its_parts_feel(name: str) -> None:
    """Forces do not depend on whether a part is searched pair by pair or the whole is swept."""
    parts, size = 4, FEW // 2
    team = parse_team("SL" * (size // 2))
    position = np.stack([cloud(k, size, 1.5, False) for k in range(parts)])
    position[..., 0] += 50.0 * np.arange(parts)[:, None]
    velocity = np.random.default_rng(7).normal(0.0, 0.3, position.shape)
    model = load(name)
    apart = model.forces(position, velocity, team)
    whole = model.forces(position.reshape(1, -1, 3), velocity.reshape(1, -1, 3), team * parts)
    np.testing.assert_array_equal(whole[0], apart.reshape(-1, 3))
    assert abs(apart[..., 2]).max() > 0.01
