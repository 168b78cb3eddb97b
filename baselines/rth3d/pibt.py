"""Priority inheritance with backtracking (PIBT), the priorities by slack.

In every step each robot, the most urgent first, takes the neighbouring vertex nearest to its goal
that no robot has taken; a robot there is asked to leave first, with the asker's priority, and
leaves to the side rather than along the asker's way. Urgent is who has far to go and has long not
been at its goal. There is no guarantee that all ever arrive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, breaks_pattern, numbers
from swarm_envs.baselines.rth3d.ways import STAY, Neighbors, neighbor_table, ways_to
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray

_Ints = npt.NDArray[np.int32]
_MOST_WAYS = 250_000_000  # lengths that are kept at most, four bytes each


class Terrain(NamedTuple):
    """The grid, and how far it is to the goals."""

    at: _Ints  # (V, 3) coordinates of each vertex
    sides: _Ints  # (3,) the shape
    strides: _Ints  # (3,) differences of the numbers of neighbours along each axis
    walls: BoolArray  # (V,) whether an obstacle stands there; of shape (0,) if there is none
    # (n, F) length of the shortest way from free vertices to each robot's goal; (0, 0) where a
    # formula says it
    ways: _Ints
    column: _Ints  # (V,) the column of `ways` of each free vertex, or (0,)
    along_x: _Ints  # (m1, m2) obstacles at smaller or equal x in the same row
    along_y: _Ints  # (m1, m2) obstacles at smaller or equal y in the same column
    table: Neighbors  # (V, 7) neighbours, or (0, 7) where all vertices have three and more


def survey(instance: GridInstance) -> Terrain:
    """The terrain of an instance.

    Raises:
        NoPlanExists: obstacles cut a robot off from its goal.
        ValueError: the lengths of ways would not fit into memory.
    """
    walls, (_, m2, m3) = instance.obstacles, instance.shape
    columns = np.asarray(walls.any(axis=2), dtype=np.int32)
    table = neighbor_table(instance.shape, walls)
    narrow = bool(((table[:, :6] >= 0).sum(axis=1)[table[:, STAY] >= 0] < 3).any())
    return Terrain(
        np.ascontiguousarray(np.indices(instance.shape, dtype=np.int32).reshape(3, -1).T),
        np.array(instance.shape, dtype=np.int32),
        np.array([m2 * m3, m3, 1], dtype=np.int32),
        walls.ravel() if walls.any() else np.zeros(0, dtype=bool),
        *_ways_to_goals(instance, table),
        np.cumsum(columns, axis=0, dtype=np.int32),
        np.cumsum(columns, axis=1, dtype=np.int32),
        table if narrow else table[:0],
    )


def _ways_to_goals(instance: GridInstance, table: Neighbors) -> tuple[_Ints, _Ints]:
    """(n, F) length of the shortest way from each free vertex to each goal, and (V,) its column.

    None, (0, 0) and (0,), where obstacles follow the pattern.
    """
    if not breaks_pattern(instance.obstacles):
        return np.zeros((0, 0), dtype=np.int32), np.zeros(0, dtype=np.int32)
    free = np.flatnonzero(table[:, STAY] >= 0)
    count = len(instance.goals)
    if count * len(free) > _MOST_WAYS:
        raise ValueError(
            f"obstacles off the pattern need the ways of {count} robots on {len(free)} vertices, "
            f"but at most {_MOST_WAYS} numbers are kept; take fewer robots or a smaller grid"
        )
    column = np.full(len(table) + 1, -1, dtype=np.int32)  # -1 stands for no neighbour
    column[free] = np.arange(len(free))
    goals = column[numbers(instance.goals, instance.shape)]
    return ways_to(column[table[free]], goals), column[:-1]


class Robots(NamedTuple):
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
    # (n, 11) robots that wait for an answer: who, number of vertices tried, of all, these, and
    # who is pulled along, or -1
    asked: _Ints
    counts: _Ints  # How many robots have each urgency
    keys: _Ints  # (7,) by which choices are sorted
    random: npt.NDArray[np.int64]  # (1,) state of the generator


_MULTIPLIER = 6364136223846793005
_INCREMENT = 1442695040888963407


@kernel
def draw(random: Array) -> int:
    """30 random bits."""
    random[0] = random[0] * _MULTIPLIER + _INCREMENT
    return (random[0] >> 33) & 0x3FFFFFFF


@kernel
def distance(terrain: Terrain, x: int, y: int, z: int, where: Array) -> int:
    """Length of a shortest path; two more than the Manhattan distance where a column is between."""
    if terrain.ways.shape[0] > 0:
        vertex = x * terrain.strides[0] + y * terrain.strides[1] + z * terrain.strides[2]
        return int(terrain.ways[where[6], terrain.column[vertex]])
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
    terrain: Terrain, robots: Robots, at: Array, robot: int, first: int, entry: Array, lost: bool
) -> None:
    """Sort a robot's choices: near its goal, off the way of `first`, free ones, at random.

    `first` began to push. Who is pushed along its way, as into a gap among robots at their goals,
    pushes it back later, and so on for ever; who steps aside, pushing others, lets it pass. When
    the robots is lost, one choice in four is at random, but of those who are at their goals.
    """
    entry[0], entry[1] = robot, 0
    where, here = robots.where[robot], at[robot]
    bits = draw(robots.random)
    keys, kept = robots.keys, 0
    away = distance(terrain, where[0], where[1], where[2], where)
    wander = lost and bits >> 28 == 0 and away > 0
    goal, ahead = robots.where[first], 0
    if first != robot:
        ahead = distance(terrain, where[0], where[1], where[2], goal)
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
            key += 64 * distance(terrain, x, y, z, where)
        if ahead > 0 and distance(terrain, x, y, z, goal) < ahead:
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
    entry[2], entry[10] = kept, -1
    if terrain.table.shape[0] > 0 and not wander:
        _back_out(terrain, robots, at, robot, entry)


@kernel
def _back_out(terrain: Terrain, robots: Robots, at: Array, robot: int, entry: Array) -> None:
    """Have a robot go where it wants least, if it takes that to change places with another."""
    kept = entry[2]
    if kept < 2 or entry[3] == at[robot]:
        return
    entry[10] = _to_pull(terrain, robots, at, robot, entry[3])
    if entry[10] >= 0:
        for k in range(kept // 2):
            entry[3 + k], entry[2 + kept - k] = entry[2 + kept - k], entry[3 + k]


@kernel
def _way(terrain: Terrain, robots: Robots, robot: int, vertex: int) -> int:
    """Length of the shortest way of a robot from a vertex to its goal."""
    x, y, z = terrain.at[vertex, 0], terrain.at[vertex, 1], terrain.at[vertex, 2]
    return distance(terrain, x, y, z, robots.where[robot])


@kernel
def _onward(terrain: Terrain, robots: Robots, back: int, here: int) -> tuple[int, int]:
    """Number of ways on from `here`, but `back`, and the last of them.

    A dead end whose robot is at its goal is none: that robot need not move.
    """
    ways, last = 0, -1
    for k in range(6):
        u = terrain.table[here, k]
        if u < 0 or u == back:
            continue
        sides, who = 0, robots.now[u]
        for j in range(6):
            if terrain.table[u, j] >= 0:
                sides += 1
        if sides > 1 or who < 0 or _way(terrain, robots, who, u) > 0:
            ways += 1
            last = u
    return ways, last


@kernel
def _must_swap(
    terrain: Terrain, robots: Robots, pusher: int, puller: int, first: int, second: int
) -> bool:
    """Whether a robot that pushes another along a passage would never get past it.

    They stand at `first` and `second`, or would.
    """
    while _way(terrain, robots, pusher, second) < _way(terrain, robots, pusher, first):
        ways, onward = _onward(terrain, robots, first, second)
        if ways >= 2:
            return False
        if ways == 0:
            break
        first, second = second, onward
    ahead = _way(terrain, robots, pusher, first)
    return _way(terrain, robots, puller, first) < _way(terrain, robots, puller, second) and (
        ahead == 0 or _way(terrain, robots, pusher, second) < ahead
    )


@kernel
def _may_swap(terrain: Terrain, robots: Robots, first: int, second: int) -> bool:
    """Whether two robots can pass each other if the one at `second` moves on before the other.

    It does where the passage ends at a branch.
    """
    begin = first
    while second != begin:
        ways, onward = _onward(terrain, robots, first, second)
        if ways >= 2:
            return True
        if ways == 0:
            return False
        first, second = second, onward
    return False


@kernel
def _to_pull(terrain: Terrain, robots: Robots, at: Array, robot: int, aim: int) -> int:
    """Who must follow a robot that wants to be at `aim`, backwards to where both can pass; or -1.

    The swap of Okumura, "Improving LaCAM for Scalable Eventually Optimal Multi-Agent Pathfinding"
    (IJCAI 2023), Sec. 4: with who is in the way, or with who comes from behind towards `aim`.
    """
    here = at[robot]
    if not _may_swap(terrain, robots, aim, here):
        return -1
    other = robots.now[aim]
    ask = other >= 0 and robots.next[other] < 0
    if ask and _must_swap(terrain, robots, robot, other, here, aim):
        return int(other)
    for k in range(6):
        u = terrain.table[here, k]
        if u < 0 or u == aim:
            continue
        other = robots.now[u]
        if other >= 0 and _must_swap(terrain, robots, other, robot, here, aim):
            return int(other)
    return -1


@kernel
def _pull(robots: Robots, at: Array, depth: int) -> None:
    """Have those follow who are to be pulled along, where the pullers go away as they wish."""
    for k in range(depth, -1, -1):
        entry = robots.asked[k]
        here, other = at[entry[0]], entry[10]
        if other >= 0 and entry[1] == 1 and robots.next[other] < 0 and robots.taken[here] < 0:
            robots.next[other] = here
            robots.taken[here] = other


@kernel
def settle_next(terrain: Terrain, robots: Robots, at: Array, robot: int, lost: bool) -> bool:
    """Settle the next vertex of a robot and of all whom it pushes away; whether that went well.

    It always does if none of them had its vertex settled before by others.
    """
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
            _pull(robots, at, depth)
            return True
    return False


@kernel
def _sort(terrain: Terrain, robots: Robots, at: Array) -> int:
    """Queue the robots by urgency; return the longest way that is left."""
    count = at.shape[0]
    longest, top = 0, robots.counts.shape[0] - 1
    for i in range(count):
        where = robots.where[i]
        for axis in range(3):
            where[axis] = terrain.at[at[i], axis]
        left = distance(terrain, where[0], where[1], where[2], where)
        robots.away[i] = robots.away[i] // 2 if left == 0 else robots.away[i] + 1
        longest = max(longest, left)
        robots.urgency[i] = top - min(left + robots.away[i], top)
    line_up(robots, draw(robots.random) % count)
    return longest


@kernel
def line_up(robots: Robots, begin: int) -> None:
    """Queue the robots by urgency; of equals, `order` decides, from its place `begin` on."""
    count, top, total = robots.queue.shape[0], robots.counts.shape[0] - 1, 0
    robots.counts[:] = 0
    for i in range(count):
        robots.counts[robots.urgency[i]] += 1
    for k in range(top + 1):
        total += robots.counts[k]
        robots.counts[k] = total - robots.counts[k]
    for k in range(count):
        i = robots.order[k + begin - count if k + begin >= count else k + begin]
        robots.queue[robots.counts[robots.urgency[i]]] = i
        robots.counts[robots.urgency[i]] += 1


@kernel
def _run_pibt(
    terrain: Terrain,
    robots: Robots,
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
                settle_next(terrain, robots, at, i, lost)
        for i in range(count):
            robots.now[at[i]] = -1
        for i in range(count):
            robots.taken[robots.next[i]] = -1
            paths[t + 1, i] = robots.next[i]
    return end, longest


class Pibt:
    """PIBT on one instance, which may go on from any step of what it has planned."""

    def __init__(self, instance: GridInstance, most_steps: int) -> None:
        self.terrain = survey(instance)
        self.instance = instance
        self.paths: Paths = np.empty((most_steps + 1, len(instance.starts)), dtype=np.int32)
        self.paths[0] = numbers(instance.starts, instance.shape)
        self.robots = new_robots(instance, most_steps)
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


def new_robots(instance: GridInstance, most_steps: int) -> Robots:
    """The robots of an instance at their starts, told apart by up to `most_steps` of urgency."""
    count, total = len(instance.starts), int(np.prod(instance.shape))
    integers = {name: np.zeros(count, dtype=np.int32) for name in ("urgency", "away", "queue")}
    return Robots(
        where=np.hstack([instance.starts, instance.goals, np.arange(count)[:, None]]).astype(
            np.int32
        ),
        keys=np.empty(7, dtype=np.int32),
        order=np.arange(count, dtype=np.int32),
        now=np.full(total, -1, dtype=np.int32),
        taken=np.full(total, -1, dtype=np.int32),
        next=np.full(count, -1, dtype=np.int32),
        asked=np.empty((count, 11), dtype=np.int32),
        counts=np.zeros(most_steps + sum(instance.shape) + 3, dtype=np.int32),
        random=np.zeros(1, dtype=np.int64),
        **integers,
    )
