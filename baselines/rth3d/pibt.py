"""Priority inheritance with backtracking (PIBT), the priorities by slack.

In every step each robot, the most urgent first, takes the neighbouring vertex nearest to its goal
that nobody has taken; who stands there is asked to leave first, with the asker's priority. Urgent
is who has far to go and has long not been at its goal. There is no guarantee that all ever arrive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.balancing import Neighbors, neighbor_table
from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import GridInstance, numbers
from swarm_envs.compiled import kernel

_Ints = npt.NDArray[np.int32]


class Terrain(NamedTuple):
    """The grid as kernels read it."""

    table: Neighbors
    at: _Ints
    """(V, 3) coordinates of each vertex."""
    along_x: _Ints
    """(m1, m2) obstacle columns at smaller x in the same row."""
    along_y: _Ints
    """(m1, m2) obstacle columns at smaller y in the same column."""


class Crowd(NamedTuple):
    """The robots, and memory for their decisions."""

    goal: _Ints
    """(n, 3)."""
    order: _Ints
    """(n,) a random order."""
    urgency: _Ints
    """(n,) steps since a robot was last at its goal, plus those that it must still go."""
    away: _Ints
    """(n,) steps since a robot was last at its goal."""
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
    random: npt.NDArray[np.int64]
    """(1,) state of the generator."""


_MULTIPLIER = 6364136223846793005
_INCREMENT = 1442695040888963407


@kernel
def _draw(random):  # type: ignore[no-untyped-def]
    """30 random bits."""
    random[0] = random[0] * _MULTIPLIER + _INCREMENT
    return (random[0] >> 33) & 0x3FFFFFFF


@kernel
def _distance(terrain, vertex, goal):  # type: ignore[no-untyped-def]
    """Length of a shortest path; two more than the Manhattan distance where a column is between."""
    x, y = terrain.at[vertex, 0], terrain.at[vertex, 1]
    found = abs(x - goal[0]) + abs(y - goal[1]) + abs(terrain.at[vertex, 2] - goal[2])
    if x == goal[0]:
        if terrain.along_y[x, y] != terrain.along_y[x, goal[1]]:
            found += 2
    elif y == goal[1] and terrain.along_x[x, y] != terrain.along_x[goal[0], y]:
        found += 2
    return found


@kernel
def _ask(terrain, crowd, at, robot, entry):  # type: ignore[no-untyped-def]
    """Sort a robot's choices: near its goal first, then free ones, then at random."""
    entry[0], entry[1] = robot, 0
    goal, here = crowd.goal[robot], at[robot]
    bits = _draw(crowd.random)
    kept = 0
    keys = np.empty(7, dtype=np.int32)
    for k in range(7):
        vertex = terrain.table[here, k]
        if vertex < 0 or crowd.taken[vertex] >= 0:
            continue
        key = 32 * _distance(terrain, vertex, goal) + ((bits >> 4 * k) & 15)
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
def _decide(terrain, crowd, at, robot):  # type: ignore[no-untyped-def]
    """Settle the next vertex of a robot and of all whom it pushes away."""
    depth = 0
    _ask(terrain, crowd, at, robot, crowd.asked[0])
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
                _ask(terrain, crowd, at, other, crowd.asked[depth])
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
def _sort(terrain, crowd, at):  # type: ignore[no-untyped-def]
    """Queue the robots by urgency; return the longest way that is left."""
    count = at.shape[0]
    longest, top = 0, crowd.counts.shape[0] - 1
    crowd.counts[:] = 0
    for i in range(count):
        left = _distance(terrain, at[i], crowd.goal[i])
        crowd.away[i] = 0 if left == 0 else crowd.away[i] + 1
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
def run_pibt(terrain, crowd, paths, begin, end, limit):  # type: ignore[no-untyped-def]
    """Plan steps begin + 1 ... end, unless all arrive before, or none can within `limit` steps.

    Returns the last planned step, and the longest way that is left to anyone then.
    """
    count = paths.shape[1]
    for t in range(begin, end + 1):
        at = paths[t]
        longest = _sort(terrain, crowd, at)
        if longest == 0 or t + longest > limit or t == end:
            return t, longest
        for i in range(count):
            crowd.now[at[i]] = i
            crowd.next[i] = -1
        for k in range(count):
            if crowd.next[crowd.queue[k]] < 0:
                _decide(terrain, crowd, at, crowd.queue[k])
        for i in range(count):
            crowd.now[at[i]] = -1
        for i in range(count):
            crowd.taken[crowd.next[i]] = -1
            paths[t + 1, i] = crowd.next[i]
    return end, longest


class Pibt:
    """PIBT on one instance, which may go on from any step of what it has planned."""

    def __init__(self, instance: GridInstance, most_steps: int) -> None:
        walls = instance.obstacles
        columns = walls.any(axis=2).astype(np.int32)
        vertex = np.indices(instance.shape, dtype=np.int32).reshape(3, -1).T
        self.terrain = Terrain(
            neighbor_table(instance.shape, walls),
            np.ascontiguousarray(vertex),
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

    def run(self, begin: int, steps: int, limit: int) -> tuple[int, int]:
        """Go on from step `begin` for so many steps; see `run_pibt`."""
        end = min(begin + steps, len(self.paths) - 1)
        last, left = run_pibt(self.terrain, self.crowd, self.paths, begin, end, limit)
        return int(last), int(left)

    def rewind(self, begin: int) -> None:
        """Forget all after step `begin`."""
        goal = numbers(self.instance.goals, self.instance.shape)
        away = self.crowd.away
        away[:] = 0
        for t in range(begin):  # how long each has been away, as if it had just walked here
            away[:] = np.where(self.paths[t] == goal, 0, away + 1)


def _crowd(instance: GridInstance, most_steps: int) -> Crowd:
    count, total = len(instance.starts), int(np.prod(instance.shape))
    integers = {name: np.zeros(count, dtype=np.int32) for name in ("urgency", "away", "queue")}
    return Crowd(
        goal=instance.goals,
        order=np.arange(count, dtype=np.int32),
        now=np.full(total, -1, dtype=np.int32),
        taken=np.full(total, -1, dtype=np.int32),
        next=np.full(count, -1, dtype=np.int32),
        asked=np.empty((count, 10), dtype=np.int32),
        counts=np.zeros(most_steps + sum(instance.shape) + 3, dtype=np.int32),
        random=np.zeros(1, dtype=np.int64),
        **integers,
    )
