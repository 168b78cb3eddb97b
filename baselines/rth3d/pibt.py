"""Priority inheritance with backtracking (PIBT), the priorities by slack.

In every step each robot, the most urgent first, takes the neighbouring vertex nearest to its goal
that nobody has taken; who stands there is asked to leave first, with the asker's priority, and
leaves to the side rather than along the asker's way. Urgent is who has far to go and has long not
been at its goal. There is no guarantee that all ever arrive.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, check_pattern, numbers
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray

_Ints = npt.NDArray[np.int32]
_MOST_WAYS = 200_000_000  # lengths that are kept at most, four bytes each
_FAR = 1 << 20  # stands for no way


class _Terrain(NamedTuple):
    at: _Ints  # (V, 3) coordinates of each vertex
    sides: _Ints  # (3,) the shape
    strides: _Ints  # (3,) differences of the numbers of neighbours along each axis
    walls: BoolArray  # (V,) whether an obstacle stands there; of shape (0,) if there is none
    # (n, V) length of the shortest way to each robot's goal; (0, 0) where a formula says it
    ways: _Ints
    along_x: _Ints  # (m1, m2) obstacles at smaller or equal x in the same row
    along_y: _Ints  # (m1, m2) obstacles at smaller or equal y in the same column


def _ways_to_goals(instance: GridInstance) -> npt.NDArray[np.int32]:
    """(n, V) length of the shortest way from each vertex to each goal, by breadth-first search.

    None, (0, 0), where obstacles follow the pattern.

    Raises:
        ValueError: it would not fit into memory, or no way leads from a start to its goal.
    """
    with suppress(ValueError):
        check_pattern(instance.obstacles)
        return np.zeros((0, 0), dtype=np.int32)
    count, free = len(instance.goals), ~instance.obstacles
    if count * free.size > _MOST_WAYS:
        raise ValueError(
            f"obstacles off the pattern need the ways of {count} robots on {free.size} vertices, "
            f"but at most {_MOST_WAYS} numbers are kept; take fewer robots or a smaller grid"
        )
    vertex = np.arange(free.size).reshape(instance.shape)
    edges = []
    for axis in range(3):
        low, high = np.moveaxis(vertex, axis, 0)[:-1], np.moveaxis(vertex, axis, 0)[1:]
        open_ = np.moveaxis(free, axis, 0)[:-1] & np.moveaxis(free, axis, 0)[1:]
        edges.append(np.stack([low[open_], high[open_]]))
    first, second = np.concatenate(edges, axis=1)
    graph = csr_matrix((np.ones(len(first)), (first, second)), shape=(free.size,) * 2)
    goals = numbers(instance.goals, instance.shape)
    ways = dijkstra(graph, directed=False, indices=goals, unweighted=True)
    starts = numbers(instance.starts, instance.shape)
    closed = np.flatnonzero(np.isinf(ways[np.arange(count), starts]))
    if len(closed):
        i = int(closed[0])
        raise ValueError(
            f"robot {i} cannot get from {instance.starts[i].tolist()} to "
            f"{instance.goals[i].tolist()}: obstacles are between; move them, or one of the two"
        )
    return np.asarray(np.where(np.isinf(ways), _FAR, ways), dtype=np.int32)


class _Robots(NamedTuple):
    """The robots, and memory for their decisions."""

    where: _Ints  # (n, 7) where each robot is now, its goal, and its row of `ways`
    order: _Ints  # (n,) a random order
    urgency: _Ints  # (n,) less the more urgent: the top, less `away` and the steps that are left
    # (n,) steps that a robot has not been at its goal, halved by each step that it is. Were it zero
    # at once, two robots in each other's way could push each other off their goals for ever
    away: _Ints
    now: _Ints  # (V,) who is on each vertex
    taken: _Ints  # (V,) who has taken it for the next step
    next: _Ints  # (n,) the vertex taken by each robot, or -1
    queue: _Ints  # (n,) robots by urgency
    # (n, 10) robots that wait for an answer: who, number of vertices tried, of all, and these
    asked: _Ints
    counts: _Ints  # How many robots have each urgency
    keys: _Ints  # (7,) by which choices are sorted
    random: npt.NDArray[np.int64]  # (1,) state of the generator


_MULTIPLIER = 6364136223846793005
_INCREMENT = 1442695040888963407


@kernel
def _draw(random: Array) -> int:
    """30 random bits."""
    random[0] = random[0] * _MULTIPLIER + _INCREMENT
    return (random[0] >> 33) & 0x3FFFFFFF


@kernel
def _distance(terrain: _Terrain, x: int, y: int, z: int, where: Array) -> int:
    """Length of a shortest path; two more than the Manhattan distance where a column is between."""
    if terrain.ways.shape[0] > 0:
        vertex = x * terrain.strides[0] + y * terrain.strides[1] + z * terrain.strides[2]
        return int(terrain.ways[where[6], vertex])
    found = int(abs(x - where[3]) + abs(y - where[4]) + abs(z - where[5]))
    if terrain.walls.shape[0] > 0:
        if x == where[3]:
            if terrain.along_y[x, y] != terrain.along_y[x, where[4]]:
                found += 2
        elif y == where[4] and terrain.along_x[x, y] != terrain.along_x[where[3], y]:
            found += 2
    return found


@kernel
def _ask(
    terrain: _Terrain, robots: _Robots, at: Array, robot: int, first: int, entry: Array, lost: bool
) -> None:
    """Sort a robot's choices: near its goal, off the way of `first`, free ones, at random.

    `first` began to push. Who is pushed along its way, as into a gap among robots at their goals,
    pushes it back later, and so on for ever; who steps aside, pushing others, lets it pass. When
    the robots is lost, one choice in four is at random, but of those who are at their goals.
    """
    entry[0], entry[1] = robot, 0
    where, here = robots.where[robot], at[robot]
    bits = _draw(robots.random)
    keys, kept = robots.keys, 0
    away = _distance(terrain, where[0], where[1], where[2], where)
    wander = lost and bits >> 28 == 0 and away > 0
    goal, ahead = robots.where[first], 0
    if first != robot:
        ahead = _distance(terrain, where[0], where[1], where[2], goal)
    for k in range(7):
        x, y, z = where[0], where[1], where[2]
        vertex = here
        if k < 6:
            axis, step = k >> 1, 2 * (k & 1) - 1
            to = where[axis] + step
            if to < 0 or to >= terrain.sides[axis]:
                continue
            vertex += step * terrain.strides[axis]
            if axis == 0:
                x = to
            elif axis == 1:
                y = to
            else:
                z = to
            if terrain.walls.shape[0] > 0 and terrain.walls[vertex]:
                continue
        if robots.taken[vertex] >= 0:
            continue
        key = (bits >> 4 * k) & 15
        if not wander:
            key += 64 * _distance(terrain, x, y, z, where)
        if ahead > 0 and _distance(terrain, x, y, z, goal) < ahead:
            key += 32
        if robots.now[vertex] >= 0 and k < 6:
            key += 16
        place = kept
        while place > 0 and keys[place - 1] > key:
            keys[place] = keys[place - 1]
            entry[3 + place] = entry[2 + place]
            place -= 1
        keys[place] = key
        entry[3 + place] = vertex
        kept += 1
    entry[2] = kept


@kernel
def _decide(terrain: _Terrain, robots: _Robots, at: Array, robot: int, lost: bool) -> None:
    """Settle the next vertex of a robot and of all whom it pushes away."""
    depth = 0
    _ask(terrain, robots, at, robot, robot, robots.asked[0], lost)
    while depth >= 0:
        entry = robots.asked[depth]
        who = entry[0]
        here = at[who]
        settled = False
        while entry[1] < entry[2]:
            vertex = entry[3 + entry[1]]
            entry[1] += 1
            other = robots.now[vertex]
            if robots.taken[vertex] >= 0:
                continue
            if other >= 0 and other != who and robots.next[other] == here:
                continue  # they would swap
            robots.taken[vertex] = who
            robots.next[who] = vertex
            if other >= 0 and other != who and robots.next[other] < 0:
                depth += 1
                _ask(terrain, robots, at, other, robot, robots.asked[depth], lost)
            else:
                settled = True
            break
        else:
            robots.next[who] = here  # nowhere to go: the one who asked must look elsewhere
            robots.taken[here] = who
            depth -= 1
            continue
        if settled:
            return


@kernel
def _sort(terrain: _Terrain, robots: _Robots, at: Array) -> int:
    """Queue the robots by urgency; return the longest way that is left."""
    count = at.shape[0]
    longest, top = 0, robots.counts.shape[0] - 1
    robots.counts[:] = 0
    for i in range(count):
        where = robots.where[i]
        for axis in range(3):
            where[axis] = terrain.at[at[i], axis]
        left = _distance(terrain, where[0], where[1], where[2], where)
        robots.away[i] = robots.away[i] // 2 if left == 0 else robots.away[i] + 1
        longest = max(longest, left)
        robots.urgency[i] = top - min(left + robots.away[i], top)
        robots.counts[robots.urgency[i]] += 1
    total = 0
    for k in range(top + 1):
        total += robots.counts[k]
        robots.counts[k] = total - robots.counts[k]
    begin = _draw(robots.random) % count
    for k in range(count):
        i = robots.order[k + begin - count if k + begin >= count else k + begin]
        robots.queue[robots.counts[robots.urgency[i]]] = i
        robots.counts[robots.urgency[i]] += 1
    return longest


@kernel
def _run_pibt(
    terrain: _Terrain,
    robots: _Robots,
    paths: Array,
    begin: int,
    end: int,
    limit: int,
    left: int,
    lost: bool,
) -> tuple[int, int]:
    """Plan steps begin + 1 ... end, unless all arrive before, or none can within `limit` steps.

    `left` is what the call that planned step `begin` has returned; -1 if there was none. Returns
    the last planned step, and the longest way that is left to anyone then.
    """
    count, top = paths.shape[1], robots.counts.shape[0] - 1
    longest = left
    for t in range(begin, end + 1):
        at = paths[t]
        if t > begin or left < 0:
            longest = _sort(terrain, robots, at)
        if longest == 0 or t + longest > limit or t == end:
            return t, longest
        for i in range(count):
            robots.now[at[i]] = i
            robots.next[i] = -1
        for k in range(count):
            i = robots.queue[k]
            if robots.next[i] >= 0:
                continue
            if robots.urgency[i] == top and robots.taken[at[i]] < 0:  # at its goal, and may stay
                robots.next[i] = at[i]
                robots.taken[at[i]] = i
            else:
                _decide(terrain, robots, at, i, lost)
        for i in range(count):
            robots.now[at[i]] = -1
        for i in range(count):
            robots.taken[robots.next[i]] = -1
            paths[t + 1, i] = robots.next[i]
    return end, longest


class Pibt:
    """PIBT on one instance, which may go on from any step of what it has planned."""

    def __init__(self, instance: GridInstance, most_steps: int) -> None:
        walls, (_, m2, m3) = instance.obstacles, instance.shape
        columns = np.asarray(walls.any(axis=2), dtype=np.int32)
        vertex = np.indices(instance.shape, dtype=np.int32).reshape(3, -1).T
        self.terrain = _Terrain(
            np.ascontiguousarray(vertex),
            np.array(instance.shape, dtype=np.int32),
            np.array([m2 * m3, m3, 1], dtype=np.int32),
            walls.ravel() if walls.any() else np.zeros(0, dtype=bool),
            _ways_to_goals(instance),
            np.cumsum(columns, axis=0, dtype=np.int32),
            np.cumsum(columns, axis=1, dtype=np.int32),
        )
        self.instance = instance
        self.paths: Paths = np.empty((most_steps + 1, len(instance.starts)), dtype=np.int32)
        self.paths[0] = numbers(instance.starts, instance.shape)
        self.robots = _robots(instance, most_steps)
        self.reached = 0

    def shuffle(self, generator: np.random.Generator) -> None:
        """Draw another order and other random choices from here on."""
        self.robots.order[:] = generator.permutation(len(self.robots.order))
        self.robots.random[0] = generator.integers(2**62)

    def run(self, begin: int, end: int, limit: int, left: int, lost: bool) -> tuple[int, int]:
        """Go on from step `begin`; see `_run_pibt`."""
        last, left = _run_pibt(self.terrain, self.robots, self.paths, begin, end, limit, left, lost)
        return int(last), int(left)

    def rewind(self, begin: int) -> None:
        """Forget all after step `begin`."""
        goal = numbers(self.instance.goals, self.instance.shape)
        away = self.robots.away
        away[:] = 0
        for t in range(begin):  # how long each has been away, as if it had just walked here
            away[:] = np.where(self.paths[t] == goal, away // 2, away + 1)


def _robots(instance: GridInstance, most_steps: int) -> _Robots:
    count, total = len(instance.starts), int(np.prod(instance.shape))
    integers = {name: np.zeros(count, dtype=np.int32) for name in ("urgency", "away", "queue")}
    return _Robots(
        where=np.hstack([instance.starts, instance.goals, np.arange(count)[:, None]]).astype(
            np.int32
        ),
        keys=np.empty(7, dtype=np.int32),
        order=np.arange(count, dtype=np.int32),
        now=np.full(total, -1, dtype=np.int32),
        taken=np.full(total, -1, dtype=np.int32),
        next=np.full(count, -1, dtype=np.int32),
        asked=np.empty((count, 10), dtype=np.int32),
        counts=np.zeros(most_steps + sum(instance.shape) + 3, dtype=np.int32),
        random=np.zeros(1, dtype=np.int64),
        **integers,
    )
