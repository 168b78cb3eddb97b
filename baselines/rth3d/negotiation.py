"""Negotiated congestion: paths of a fixed number of steps for all robots, without collisions.

At first paths may collide. Then robots that collide are replanned again and again, each along the
cheapest path in space and time, while vertices at which they collide become more expensive, until
no robots collide. It is the method of circuit routers: McMurchie and Ebeling, "PathFinder: A
Negotiation-Based Performance-Driven Router for FPGAs" (FPGA 1995). It suits crowds that move in
opposite directions, which PIBT leads into each other step by step. There is no guarantee.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, numbers
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.path_lengths import Ints, Neighbors, neighbor_table
from swarm_envs.baselines.rth3d.pibt import following
from swarm_envs.compiled import equation, kernel

_MOST_PLACES = 40_000_000  # The most vertices times steps, 19 bytes each
_WORK, _MOST_WORK = 6000, 1_000_000_000
"""The most moves that are evaluated, as a multiple of robots times bound, and in total: some five
seconds."""
_GLANCE = 50_000_000  # The most between two checks of the clock
_ROUNDS = 60
_TRIES = 4  # Attempts with other random choices; a failed one takes little of the work
_PRICE = 64  # The price of a collision in the first round; ties are broken by up to 7
_DEAREST = 8 * _PRICE


class _Space(NamedTuple):
    """The grid at each step, its use, and the prices of its vertices."""

    at: Ints  # (V, 3) coordinates of each vertex
    table: Neighbors  # (V, 7) neighbors
    used: npt.NDArray[np.int16]  # (T + 1, V) number of robots on each vertex
    moves: npt.NDArray[np.int16]  # (T, V, 6) number of robots that leave it along each edge
    dear: Ints  # (T + 1, V) surcharge of a vertex for collisions there
    back: npt.NDArray[np.int8]  # (T + 1, V) the edge by which the cheapest path arrives
    # (2, V) cost of the cheapest paths so far, at even and odd steps; -1 without one
    cost: npt.NDArray[np.int64]
    reached: Ints  # (2, V) vertices reached by paths, at even and odd steps
    random: npt.NDArray[np.int64]  # (1,) state of the generator


@kernel
def _lead(space: _Space, path: Array, goal: int, price: int) -> int:
    """Write a cheapest path (T + 1,) of a robot to its goal; return the number of moves evaluated.

    Without a path of T steps, nothing is written. `price` is that of a collision.
    """
    at, table, used, moves, dear, back, cost, reached, random = space
    steps, bits = path.shape[0] - 1, random[0]
    x, y, z = at[goal, 0], at[goal, 1], at[goal, 2]
    reached[0, 0], cost[0, path[0]] = path[0], 0
    count, weighed = 1, 0
    for t in range(steps):
        even, odd, kept = t & 1, (t + 1) & 1, 0
        for k in range(count):
            v = reached[even, k]
            for edge in range(7):
                u = table[v, edge]
                if u < 0:
                    continue
                distance = abs(at[u, 0] - x) + abs(at[u, 1] - y) + abs(at[u, 2] - z)
                if t + 1 + distance > steps:
                    continue
                bits = following(bits)
                value = cost[even, v] + price * used[t + 1, u] + dear[t + 1, u]
                value += (bits >> 33) & 7  # Random tie-breaking
                if edge < 6:
                    value += price * moves[t, u, edge ^ 1]
                if cost[odd, u] < 0:
                    reached[odd, kept] = u
                    kept += 1
                elif cost[odd, u] <= value:
                    continue
                cost[odd, u] = value
                back[t + 1, u] = edge
        weighed += 7 * count
        for k in range(count):
            cost[even, reached[even, k]] = -1
        count = kept
    random[0] = bits
    if count == 0:
        return weighed
    cost[steps & 1, goal] = -1
    path[steps] = goal
    for t in range(steps, 0, -1):
        edge = back[t, path[t]]
        path[t - 1] = path[t] if edge == 6 else table[path[t], edge ^ 1]
    return weighed


@equation
def _edge(table: Array, before: int, now: int) -> int:
    """Return the edge from a vertex to another, or 6 to itself."""
    edge = 0
    while table[before, edge] != now:
        edge += 1
    return edge


@kernel
def _use(space: _Space, path: Array, change: int) -> None:
    """Add a path to the use of the grid (`change` 1), or remove it (-1)."""
    table, used, moves = space.table, space.used, space.moves
    used[0, path[0]] += change
    for t in range(1, path.shape[0]):
        used[t, path[t]] += change
        edge = _edge(table, path[t - 1], path[t])
        if edge < 6:
            moves[t - 1, path[t - 1], edge] += change


@kernel
def _collides(space: _Space, path: Array) -> bool:
    """Return True if a path collides with others; raise the prices of vertices where it does."""
    table, used, moves, dear = space.table, space.used, space.moves, space.dear
    found = False
    for t in range(1, path.shape[0]):
        edge = _edge(table, path[t - 1], path[t])
        if used[t, path[t]] > 1 or (edge < 6 and moves[t - 1, path[t], edge ^ 1] > 0):
            dear[t, path[t]] += _PRICE
            found = True
    return found


@kernel
def _lead_some(
    space: _Space,
    paths: Array,
    goals: Array,
    order: Array,
    begin: int,
    price: int,
    most: int,
) -> tuple[int, int, int]:
    """Replan robots that collide, or have no path yet, until `most` moves have been evaluated.

    Returns the next index in `order`, the number of replanned robots, and that of moves.
    """
    count, weighed = 0, 0
    while begin < order.shape[0] and weighed < most:
        i = order[begin]
        begin += 1
        if paths[i, 1] >= 0:
            if not _collides(space, paths[i]):
                continue
            _use(space, paths[i], -1)
        weighed += _lead(space, paths[i], goals[i], price)
        _use(space, paths[i], 1)
        count += 1
    return begin, count, weighed


class Negotiation:
    """The search on one instance, for plans of any number of steps."""

    def __init__(self, instance: GridInstance, seed: int, clock: PlanningClock, work: int) -> None:
        self._instance = instance
        self._goals = numbers(instance.goals, instance.shape)
        self._at = np.ascontiguousarray(np.indices(instance.shape, dtype=np.int32).reshape(3, -1).T)
        self._table = neighbor_table(instance.shape, instance.obstacles)
        self._generator = np.random.default_rng(seed)
        self._clock = clock
        self._work = work

    @property
    def goes_on(self) -> bool:
        """True while neither work nor time has run out."""
        return self._work > 0 and self._clock.remaining > 0

    def fits(self, steps: int) -> bool:
        """Return True if the grid at each of `steps` steps fits into memory."""
        return (steps + 1) * len(self._table) <= _MOST_PLACES

    def plan(self, steps: int) -> Paths | None:
        """Return a plan (T + 1, n) of `steps` steps, or None if none was found."""
        space, count = self._new_space(steps), len(self._goals)
        paths = np.full((count, steps + 1), -1, dtype=np.int32)
        paths[:, 0] = numbers(self._instance.starts, self._instance.shape)
        order, price = self._generator.permutation(count), _PRICE
        for _ in range(1 + _ROUNDS):
            if self._round(space, paths, order, price) == 0:
                return np.ascontiguousarray(paths.T)
            price = min(price + price // 8, _DEAREST)
        return None

    def _round(self, space: _Space, paths: Array, order: Array, price: int) -> int:
        """Replan robots that collide; return their number, at least 1 if work or time ended."""
        begin, count = 0, 0
        while begin < len(order):
            if not self.goes_on:
                return max(count, 1)
            begin, some, weighed = _lead_some(
                space, paths, self._goals, order, begin, price, _GLANCE
            )
            count += some
            self._work -= weighed
        return count

    def _new_space(self, steps: int) -> _Space:
        total = len(self._table)
        return _Space(
            at=self._at,
            table=self._table,
            used=np.zeros((steps + 1, total), dtype=np.int16),
            moves=np.zeros((steps, total, 6), dtype=np.int16),
            dear=np.zeros((steps + 1, total), dtype=np.int32),
            back=np.zeros((steps + 1, total), dtype=np.int8),
            cost=np.full((2, total), -1, dtype=np.int64),
            reached=np.zeros((2, total), dtype=np.int32),
            random=self._generator.integers(2**62, size=1, dtype=np.int64),
        )


def negotiate(instance: GridInstance, seed: int, clock: PlanningClock, known: int) -> Paths | None:
    """Return the shortest plan that bisection finds below a known makespan, or None."""
    bound, best = instance.lower_bound, None
    work = min(_WORK * len(instance.starts) * bound, _MOST_WORK)
    search = Negotiation(instance, seed, clock, work)
    steps = min(known - 1, bound + bound // 4)
    while bound <= steps < known and search.goes_on and search.fits(steps):
        tries = (search.plan(steps) for _ in range(_TRIES) if search.goes_on)
        found = next((paths for paths in tries if paths is not None), None)
        if found is None:
            bound = steps + 1
        else:
            best, known = found, steps
        steps = (bound + known) // 2
    return best
