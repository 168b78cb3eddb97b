"""Priority inheritance with backtracking (PIBT), with priorities by slack.

In every step each robot, the most urgent first, takes the neighboring vertex nearest to its goal
that no robot has taken. A robot there inherits the priority and chooses its vertex first; it
prefers to leave the path of the robot that pushes it. A robot is urgent if it has far to go and has
long not been at its goal. There is no guarantee that all ever arrive.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, numbers
from swarm_envs.baselines.rth3d.path_lengths import Ints
from swarm_envs.baselines.rth3d.terrain import ANY, OPEN, Terrain, neighbor, survey
from swarm_envs.compiled import entry_point, equation, kernel

_ROBOT = np.dtype(
    [
        *((name, np.int32) for name in ("x", "y", "z")),  # Its goal
        # The largest number less `away` and the remaining steps: lower is more urgent
        ("urgency", np.int32),
        # The steps away from its goal, halved by each step at the goal. If it were reset to zero,
        # two robots that block each other could push each other off their goals for ever
        ("away", np.int32),
        ("next", np.int32),  # The vertex that it has taken, or -1
        ("order", np.int32),  # Not of this robot: a random order of all
        ("queue", np.int32),  # Not of this robot: all, by urgency
    ]
)


_MOST_AWAY = 10_000  # The limit of steps away from the goal in the urgency, which keeps steps fast


class Robots(NamedTuple):
    """The robots, and memory for their decisions."""

    records: Array  # (n,) of `_ROBOT`
    # (n, 18) the stack of pushed robots: robot, number of vertices tried, number of vertices, these
    # vertices, the robot that is pulled along or -1, and the sort keys of the vertices
    stack: Ints
    counts: Ints  # The number of robots of each urgency
    random: npt.NDArray[np.int64]  # (1,) state of the generator


@equation
def following(state: int) -> int:
    """Return the next state of a linear congruential generator; its upper bits are random."""
    return state * 6364136223846793005 + 1442695040888963407


@equation
def draw(random: Array) -> int:
    """Return 30 random bits."""
    random[0] = following(random[0])
    return (random[0] >> 33) & 0x3FFFFFFF


@equation
def _manhattan(cell: Array, goal: Array) -> int:
    x, y, z = cell["x"] - goal["x"], cell["y"] - goal["y"], cell["z"] - goal["z"]
    return int(abs(x) + abs(y) + abs(z))


@kernel
def _length_around(terrain: Terrain, robots: Robots, robot: int, vertex: int) -> int:
    cells, cell, goal = terrain.cells, terrain.cells[vertex], robots.records[robot]
    if terrain.grid.obstacles == ANY:
        return int(terrain.lengths[robot, cell["column"]])
    x, y, _, m2, m3 = cell["x"], cell["y"], *terrain.grid[1:]
    found = _manhattan(cell, goal)
    if x == goal["x"]:
        if cell["along_y"] != cells[(x * m2 + goal["y"]) * m3]["along_y"]:
            found += 2
    elif y == goal["y"] and cell["along_x"] != cells[(goal["x"] * m2 + y) * m3]["along_x"]:
        found += 2
    return found


@equation
def path_length(terrain: Terrain, robots: Robots, robot: int, vertex: int) -> int:
    """Return the length of a robot's shortest path from a vertex to its goal."""
    if terrain.grid.obstacles == OPEN:
        return _manhattan(terrain.cells[vertex], robots.records[robot])
    return _length_around(terrain, robots, robot, vertex)


@kernel
def _sort_choices(
    terrain: Terrain, robots: Robots, here: int, robot: int, first: int, depth: int, lost: bool
) -> None:
    """Sort a robot's choices: near its goal, off the path of `first`, free ones, at random.

    `first` is the robot that began to push. A robot pushed along its path, as into a gap among
    robots at their goals, would later push it back, and so on for ever; one that steps aside, even
    pushing others, lets it pass. If `lost`, a robot that is not at its goal sorts at random in one
    of four cases.
    """
    bits, kept, stack = draw(robots.random), 0, robots.stack
    grid, cells, records = terrain.grid, terrain.cells, robots.records
    cell, is_open = cells[here], grid.obstacles == OPEN
    wander = lost and bits >> 28 == 0 and path_length(terrain, robots, robot, here) > 0
    ahead = 0 if first == robot else path_length(terrain, robots, first, here)
    for k in range(7):
        vertex = neighbor(grid, cell, here, k)
        if vertex < 0 or cells[vertex]["taken"] >= 0:
            continue
        to, key = cells[vertex], (bits >> 4 * k) & 15
        if not wander:
            # A call with arrays takes as long as all else together.
            left = (
                _manhattan(to, records[robot])
                if is_open
                else _length_around(terrain, robots, robot, vertex)
            )
            key += 64 * left
        if ahead > 0:
            left = (
                _manhattan(to, records[first])
                if is_open
                else _length_around(terrain, robots, first, vertex)
            )
            key += 32 * (left < ahead)
        if k < 6 and to["now"] >= 0:
            key += 16
        place = kept
        while place > 0 and stack[depth, 10 + place] > key:
            stack[depth, 11 + place] = stack[depth, 10 + place]
            stack[depth, 3 + place] = stack[depth, 2 + place]
            place -= 1
        stack[depth, 11 + place] = key
        stack[depth, 3 + place] = vertex
        kept += 1
    stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 10] = robot, 0, kept, -1
    if terrain.table.shape[0] > 0 and not wander:
        _back_out(terrain, robots, here, robot, stack[depth])


@kernel
def _back_out(terrain: Terrain, robots: Robots, here: int, robot: int, entry: Array) -> None:
    """Reverse a robot's choices if it must back out to swap with another."""
    kept = entry[2]
    if kept < 2 or entry[3] == here:
        return
    entry[10] = _to_pull(terrain, robots, here, robot, entry[3])
    if entry[10] >= 0:
        for k in range(kept // 2):
            entry[3 + k], entry[2 + kept - k] = entry[2 + kept - k], entry[3 + k]


@kernel
def _onward(terrain: Terrain, robots: Robots, back: int, here: int) -> tuple[int, int]:
    """Return the number of vertices to go to from `here`, except `back`, and the last of them.

    A dead end whose robot is at its goal does not count: that robot need not move.
    """
    branches, last = 0, -1
    for k in range(6):
        u = terrain.table[here, k]
        if u < 0 or u == back:
            continue
        sides, who = 0, terrain.cells[u]["now"]
        for j in range(6):
            if terrain.table[u, j] >= 0:
                sides += 1
        if sides > 1 or who < 0 or path_length(terrain, robots, who, u) > 0:
            branches += 1
            last = u
    return branches, last


@kernel
def _must_swap(
    terrain: Terrain, robots: Robots, pusher: int, puller: int, first: int, second: int
) -> bool:
    """Return True if a robot at `first` that pushes one at `second` would never get past it."""
    while path_length(terrain, robots, pusher, second) < path_length(
        terrain, robots, pusher, first
    ):
        branches, onward = _onward(terrain, robots, first, second)
        if branches >= 2:
            return False
        if branches == 0:
            break
        first, second = second, onward
    ahead = path_length(terrain, robots, pusher, first)
    return path_length(terrain, robots, puller, first) < path_length(
        terrain, robots, puller, second
    ) and (ahead == 0 or path_length(terrain, robots, pusher, second) < ahead)


@kernel
def _may_swap(terrain: Terrain, robots: Robots, first: int, second: int) -> bool:
    """Return True if the passage of two robots ends at a branch, where they can pass."""
    begin = first
    while second != begin:
        branches, onward = _onward(terrain, robots, first, second)
        if branches >= 2:
            return True
        if branches == 0:
            return False
        first, second = second, onward
    return False


@kernel
def _to_pull(terrain: Terrain, robots: Robots, here: int, robot: int, aim: int) -> int:
    """Return the robot that must follow one whose first choice is `aim`, or -1.

    Both go backwards to a vertex where they can pass. It is the swap of Okumura, "Improving LaCAM
    for Scalable Eventually Optimal Multi-Agent Pathfinding" (IJCAI 2023), Sec. 4, with the robot at
    `aim`, or with one that comes from behind.
    """
    if not _may_swap(terrain, robots, aim, here):
        return -1
    other = terrain.cells[aim]["now"]
    ask = other >= 0 and robots.records[other]["next"] < 0
    if ask and _must_swap(terrain, robots, robot, other, here, aim):
        return int(other)
    for k in range(6):
        u = terrain.table[here, k]
        if u < 0 or u == aim:
            continue
        other = terrain.cells[u]["now"]
        if other >= 0 and _must_swap(terrain, robots, other, robot, here, aim):
            return int(other)
    return -1


@kernel
def _pull(terrain: Terrain, robots: Robots, at: Array, depth: int) -> None:
    """Let robots that are to be pulled along follow, if the pullers got their first choices."""
    for k in range(depth, -1, -1):
        entry = robots.stack[k]
        here, other = at[entry[0]], entry[10]
        if other < 0 or entry[1] != 1:
            continue
        if robots.records[other]["next"] < 0 and terrain.cells[here]["taken"] < 0:
            take(terrain.cells, robots.records, other, here)


@equation
def take(cells: Array, records: Array, robot: int, vertex: int) -> None:
    """Let a robot be at a vertex in the next step."""
    records[robot]["next"] = vertex
    cells[vertex]["taken"] = robot


@kernel
def settle_next(terrain: Terrain, robots: Robots, at: Array, robot: int, lost: bool) -> bool:
    """Settle the next vertex of a robot and of all that it pushes; return True on success.

    It always succeeds if no robot was settled by constraints before.
    """
    stack, cells, records = robots.stack, terrain.cells, robots.records
    depth: Any = np.int64(0)  # with a literal, Numba would compile callees twice
    _sort_choices(terrain, robots, at[robot], robot, robot, depth, lost)
    while depth >= 0:
        who = stack[depth, 0]
        here = at[who]
        settled = False
        while stack[depth, 1] < stack[depth, 2]:
            vertex = stack[depth, 3 + stack[depth, 1]]
            stack[depth, 1] += 1
            other = cells[vertex]["now"]
            if cells[vertex]["taken"] >= 0:
                continue
            if other >= 0 and other != who and records[other]["next"] == here:
                continue  # They would swap
            take(cells, records, who, vertex)
            if other >= 0 and other != who and records[other]["next"] < 0:
                depth += 1
                _sort_choices(terrain, robots, at[other], other, robot, depth, lost)
            else:
                settled = True
            break
        else:
            take(cells, records, who, here)  # It must stay: the robot that pushed tries another
            depth -= 1
            continue
        if settled:
            if terrain.table.shape[0] > 0:
                _pull(terrain, robots, at, depth)
            return True
    return False


@kernel
def settle_rest(terrain: Terrain, robots: Robots, at: Array, lost: bool) -> bool:
    """Settle all other robots, the most urgent first; return False if one cannot be settled.

    All can be settled if none was settled by constraints before.
    """
    cells, records, top = terrain.cells, robots.records, robots.counts.shape[0] - 1
    for k in range(at.shape[0]):
        i = records[k]["queue"]
        if records[i]["next"] >= 0:
            continue
        if records[i]["urgency"] == top and cells[at[i]]["taken"] < 0:  # At its goal, and may stay
            take(cells, records, i, at[i])
        elif not settle_next(terrain, robots, at, i, lost):
            return False
    return True


@kernel
def _sort(terrain: Terrain, robots: Robots, at: Array) -> int:
    """Queue the robots by urgency; return the longest remaining path."""
    cells, records, count = terrain.cells, robots.records, at.shape[0]
    longest, top, is_open = 0, robots.counts.shape[0] - 1, terrain.grid.obstacles == OPEN
    for i in range(count):
        if is_open:
            left = _manhattan(cells[at[i]], records[i])
        else:
            left = _length_around(terrain, robots, i, at[i])
        records[i]["away"] = records[i]["away"] // 2 if left == 0 else records[i]["away"] + 1
        longest = max(longest, left)
        records[i]["urgency"] = top - min(left + records[i]["away"], top)
    line_up(robots, draw(robots.random) % count)
    return longest


@kernel
def line_up(robots: Robots, begin: int) -> None:
    """Queue the robots by urgency, and equals by `order`, from its index `begin` on."""
    records, counts = robots.records, robots.counts
    count, total = records.shape[0], 0
    counts[:] = 0
    for i in range(count):
        counts[records[i]["urgency"]] += 1
    for k in range(counts.shape[0]):
        total += counts[k]
        counts[k] = total - counts[k]
    for k in range(count):
        i = records[k + begin - count if k + begin >= count else k + begin]["order"]
        records[counts[records[i]["urgency"]]]["queue"] = i
        counts[records[i]["urgency"]] += 1


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
    """Plan steps begin + 1 ... end, unless all arrive before, or cannot within `limit` steps.

    `left` is the second result of the call that planned step `begin`, or -1 if there was none.
    Returns the last planned step, and the longest remaining path then.
    """
    cells, records, count, longest = terrain.cells, robots.records, paths.shape[1], left
    for t in range(begin, end + 1):
        at = paths[t]
        if t > begin or left < 0:
            longest = _sort(terrain, robots, at)
        if longest == 0 or t + longest > limit or t == end:
            return t, longest
        for i in range(count):
            cells[at[i]]["now"] = i
            records[i]["next"] = -1
        settle_rest(terrain, robots, at, lost)
        for i in range(count):
            cells[at[i]]["now"] = -1
        for i in range(count):
            paths[t + 1, i] = records[i]["next"]
            cells[records[i]["next"]]["taken"] = -1
    return end, longest


class Pibt:
    """PIBT on one instance, which can continue from any planned step."""

    def __init__(self, instance: GridInstance, most_steps: int) -> None:
        self.terrain = survey(instance)
        self.instance = instance
        self.paths: Paths = np.empty((most_steps + 1, len(instance.starts)), dtype=np.int32)
        self.paths[0] = numbers(instance.starts, instance.shape)
        self.robots = new_robots(instance, most_steps)
        self._given = self.terrain, self.robots, self.paths
        self._run = entry_point(_run_pibt, *self._given, 0, 0, 0, 0, False)

    def reseed(self, generator: np.random.Generator) -> None:
        """Draw another order and other random choices from here on."""
        self.robots.records["order"] = generator.permutation(len(self.robots.records))
        self.robots.random[0] = generator.integers(2**62)

    def run(self, begin: int, end: int, limit: int, left: int, lost: bool) -> tuple[int, int]:
        """Continue from step `begin`; see `_run_pibt`."""
        last, left = self._run(*self._given, begin, end, limit, left, lost)
        return int(last), int(left)

    def rewind(self, begin: int) -> None:
        """Discard all steps after step `begin`."""
        goal = numbers(self.instance.goals, self.instance.shape)
        away = self.robots.records["away"]
        away[:] = 0
        for t in range(begin):  # Recomputes the steps that each has been away
            away[:] = np.where(self.paths[t] == goal, away // 2, away + 1)


def new_robots(instance: GridInstance, most_steps: int) -> Robots:
    """Return the robots of an instance, with room for `most_steps` levels of urgency."""
    count = len(instance.starts)
    records = np.zeros(count, dtype=_ROBOT)
    records["x"], records["y"], records["z"] = instance.goals.T
    return Robots(
        records=records,
        stack=np.empty((count, 18), dtype=np.int32),
        counts=np.zeros(min(most_steps, _MOST_AWAY) + sum(instance.shape) + 3, dtype=np.int32),
        random=np.zeros(1, dtype=np.int64),
    )
