"""Priority inheritance with backtracking (PIBT), the priorities by slack.

In every step each robot, the most urgent first, takes the neighbouring vertex nearest to its goal
that nobody has taken; who stands there is asked to leave first, with the asker's priority, and
leaves to the side rather than along the asker's way. Urgent is who has far to go and has long not
been at its goal. There is no guarantee that all ever arrive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, follows_pattern, numbers
from swarm_envs.baselines.rth3d.terrain import Terrain, ways_to_goals
from swarm_envs.compiled import kernel

_Ints = npt.NDArray[np.int32]


class Crowd(NamedTuple):
    """The robots, and memory for their decisions."""

    where: _Ints
    """(n, 7) where each robot is now, its goal, and its row of `ways`."""
    order: _Ints
    """(n,) a random order."""
    urgency: _Ints
    """(n,) less the more urgent: the top, less `away` and the steps that are left."""
    away: _Ints
    """(n,) steps that a robot has not been at its goal, halved by each step that it is. Were it
    zero at once, two robots in each other's way could push each other off their goals for ever."""
    now: _Ints
    """(V,) who is on each vertex."""
    taken: _Ints
    """(V,) who has taken it for the next step."""
    next: _Ints
    """(n,) the vertex taken by each robot, or -1."""
    queue: _Ints
    """(n,) robots by urgency."""
    asked: _Ints
    """(n, 10) robots that wait for an answer: who, number of vertices tried, of all, and these."""
    counts: _Ints
    """How many robots have each urgency."""
    keys: _Ints
    """(7,) by which choices are sorted."""
    random: npt.NDArray[np.int64]
    """(1,) state of the generator."""


_MULTIPLIER = 6364136223846793005
_INCREMENT = 1442695040888963407


@kernel
def _draw(random: Array) -> int:
    """30 random bits."""
    random[0] = random[0] * _MULTIPLIER + _INCREMENT
    return (random[0] >> 33) & 0x3FFFFFFF


@kernel
def _distance(terrain: Terrain, x: int, y: int, z: int, where: Array) -> int:
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
    terrain: Terrain, crowd: Crowd, at: Array, robot: int, first: int, entry: Array, lost: bool
) -> None:
    """Sort a robot's choices: near its goal, off the way of `first`, free ones, at random.

    `first` began to push. Who is pushed along its way, as into a gap among robots at their goals,
    pushes it back later, and so on for ever; who steps aside, pushing others, lets it pass. When
    the crowd is lost, one choice in four is at random, but of those who are at their goals.
    """
    entry[0], entry[1] = robot, 0
    where, here = crowd.where[robot], at[robot]
    bits = _draw(crowd.random)
    keys, kept = crowd.keys, 0
    away = _distance(terrain, where[0], where[1], where[2], where)
    wander = lost and bits >> 28 == 0 and away > 0
    goal, ahead = crowd.where[first], 0
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
        if crowd.taken[vertex] >= 0:
            continue
        key = (bits >> 4 * k) & 15
        if not wander:
            key += 64 * _distance(terrain, x, y, z, where)
        if ahead > 0 and _distance(terrain, x, y, z, goal) < ahead:
            key += 32
        if crowd.now[vertex] >= 0 and k < 6:
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
def _decide(terrain: Terrain, crowd: Crowd, at: Array, robot: int, lost: bool) -> None:
    """Settle the next vertex of a robot and of all whom it pushes away."""
    depth = 0
    _ask(terrain, crowd, at, robot, robot, crowd.asked[0], lost)
    while depth >= 0:
        entry = crowd.asked[depth]
        who = entry[0]
        here = at[who]
        settled = False
        while entry[1] < entry[2]:
            vertex = entry[3 + entry[1]]
            entry[1] += 1
            other = crowd.now[vertex]
            if crowd.taken[vertex] >= 0:
                continue
            if other >= 0 and other != who and crowd.next[other] == here:
                continue  # they would swap
            crowd.taken[vertex] = who
            crowd.next[who] = vertex
            if other >= 0 and other != who and crowd.next[other] < 0:
                depth += 1
                _ask(terrain, crowd, at, other, robot, crowd.asked[depth], lost)
            else:
                settled = True
            break
        else:
            crowd.next[who] = here  # nowhere to go: the one who asked must look elsewhere
            crowd.taken[here] = who
            depth -= 1
            continue
        if settled:
            return


@kernel
def _sort(terrain: Terrain, crowd: Crowd, at: Array) -> int:
    """Queue the robots by urgency; return the longest way that is left."""
    count = at.shape[0]
    longest, top = 0, crowd.counts.shape[0] - 1
    crowd.counts[:] = 0
    for i in range(count):
        where = crowd.where[i]
        for axis in range(3):
            where[axis] = terrain.at[at[i], axis]
        left = _distance(terrain, where[0], where[1], where[2], where)
        crowd.away[i] = crowd.away[i] // 2 if left == 0 else crowd.away[i] + 1
        longest = max(longest, left)
        crowd.urgency[i] = top - min(left + crowd.away[i], top)
        crowd.counts[crowd.urgency[i]] += 1
    total = 0
    for k in range(top + 1):
        total += crowd.counts[k]
        crowd.counts[k] = total - crowd.counts[k]
    begin = _draw(crowd.random) % count
    for k in range(count):
        i = crowd.order[k + begin - count if k + begin >= count else k + begin]
        crowd.queue[crowd.counts[crowd.urgency[i]]] = i
        crowd.counts[crowd.urgency[i]] += 1
    return longest


@kernel
def run_pibt(
    terrain: Terrain,
    crowd: Crowd,
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
    count, top = paths.shape[1], crowd.counts.shape[0] - 1
    longest = left
    for t in range(begin, end + 1):
        at = paths[t]
        if t > begin or left < 0:
            longest = _sort(terrain, crowd, at)
        if longest == 0 or t + longest > limit or t == end:
            return t, longest
        for i in range(count):
            crowd.now[at[i]] = i
            crowd.next[i] = -1
        for k in range(count):
            i = crowd.queue[k]
            if crowd.next[i] >= 0:
                continue
            if crowd.urgency[i] == top and crowd.taken[at[i]] < 0:  # at its goal, and may stay
                crowd.next[i] = at[i]
                crowd.taken[at[i]] = i
            else:
                _decide(terrain, crowd, at, i, lost)
        for i in range(count):
            crowd.now[at[i]] = -1
        for i in range(count):
            crowd.taken[crowd.next[i]] = -1
            paths[t + 1, i] = crowd.next[i]
    return end, longest


class Pibt:
    """PIBT on one instance, which may go on from any step of what it has planned."""

    def __init__(self, instance: GridInstance, most_steps: int) -> None:
        walls, (_, m2, m3) = instance.obstacles, instance.shape
        columns = np.asarray(walls.any(axis=2), dtype=np.int32)
        vertex = np.indices(instance.shape, dtype=np.int32).reshape(3, -1).T
        self.terrain = Terrain(
            np.ascontiguousarray(vertex),
            np.array(instance.shape, dtype=np.int32),
            np.array([m2 * m3, m3, 1], dtype=np.int32),
            walls.ravel() if walls.any() else np.zeros(0, dtype=bool),
            np.zeros((0, 0), dtype=np.int32) if follows_pattern(walls) else ways_to_goals(instance),
            np.cumsum(columns, axis=0, dtype=np.int32),
            np.cumsum(columns, axis=1, dtype=np.int32),
        )
        self.instance = instance
        self.paths: Paths = np.empty((most_steps + 1, len(instance.starts)), dtype=np.int32)
        self.paths[0] = numbers(instance.starts, instance.shape)
        self.crowd = _crowd(instance, most_steps)
        self.reached = 0

    def shuffle(self, generator: np.random.Generator) -> None:
        """Draw another order and other random choices from here on."""
        self.crowd.order[:] = generator.permutation(len(self.crowd.order))
        self.crowd.random[0] = generator.integers(2**62)

    def run(self, begin: int, end: int, limit: int, left: int, lost: bool) -> tuple[int, int]:
        """Go on from step `begin`; see `run_pibt`."""
        last, left = run_pibt(self.terrain, self.crowd, self.paths, begin, end, limit, left, lost)
        return int(last), int(left)

    def rewind(self, begin: int) -> None:
        """Forget all after step `begin`."""
        goal = numbers(self.instance.goals, self.instance.shape)
        away = self.crowd.away
        away[:] = 0
        for t in range(begin):  # how long each has been away, as if it had just walked here
            away[:] = np.where(self.paths[t] == goal, away // 2, away + 1)


def _crowd(instance: GridInstance, most_steps: int) -> Crowd:
    count, total = len(instance.starts), int(np.prod(instance.shape))
    integers = {name: np.zeros(count, dtype=np.int32) for name in ("urgency", "away", "queue")}
    return Crowd(
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
