"""LaCAM*: a complete search over configurations, whose steps are PIBT's.

A configuration is the positions of all robots. The search is depth-first: from the configuration on
top of a stack it makes one successor by PIBT under constraints. Constraints fix the next vertices
of some robots; they grow one robot at a time, breadth-first, so that in the end every successor has
been made. If there is a plan, it is found; if the stack becomes empty without one, none exists.
After the first plan the search continues to shorter ones: configurations that can no longer lead to
one are omitted, and if a shorter path to a configuration is found, its successors are updated. The
last plan when the stack is empty is the shortest.

A robot is urgent if it has long not been at its goal, and of those with equal times, if its start
is far from its goal. Unlike with the slacks of `pibt`, one robot leads until it arrives, as narrow
passages require.

Okumura, "LaCAM: Search-Based Algorithm for Quick Multi-Agent Pathfinding" (AAAI 2023), "Improving
LaCAM for Scalable Eventually Optimal Multi-Agent Pathfinding" (IJCAI 2023).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import (
    Array,
    GridInstance,
    NoPlanExists,
    PlanNotFound,
    numbers,
)
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.path_lengths import Ints
from swarm_envs.baselines.rth3d.pibt import (
    Robots,
    draw,
    line_up,
    new_robots,
    path_length,
    settle_rest,
    take,
)
from swarm_envs.baselines.rth3d.terrain import WALL, Terrain, neighbor, survey
from swarm_envs.compiled import entry_point, kernel

_Longs = npt.NDArray[np.int64]

_MOST_ENTRIES = 100_000_000  # The most robots times configurations, 0.8 GB
_MOST = 1_000_000  # The most configurations without a plan, if they fit into memory
_MORE_ENTRIES = 1_000_000  # The most entries after the first plan, and `_MORE` configurations
_MORE = 1000
_GLANCE = 250_000  # Entries between two checks of the clock
_RESTART = 1000  # One in this number of known configurations returns the search to the starts
_SLACK = 1000  # Steps beyond the longest path after which no robot becomes more urgent
_EXHAUSTED, _ENDED, _FULL = 0, 1, 2  # Results of `_search`

_TOP, _NODES, _CONSTRAINTS, _EDGES, _MADE, _GOAL, _LOADED = range(7)
_PARENT, _WHO, _TO, _DEPTH, _NEXT = range(5)


class _Nodes(NamedTuple):
    """The configurations that have been found, numbered from 0, the starts."""

    at: Ints  # (M, n) each robot's vertex
    away: Ints  # (M, n) number of configurations since each was at its goal
    parent: Ints  # (M,) the previous configuration, or -1
    steps: Ints  # (M,) steps from the starts, by the parents
    left: Ints  # (M,) longest remaining path of a robot
    hash: _Longs  # (M,)
    above: Ints  # (M,) the configuration above it on the stack, or -1
    below: Ints  # (M,) the configuration below it on the stack, or -1
    stacked: npt.NDArray[np.bool_]  # (M,) True if it is on the stack
    first: Ints  # (M,) the first of its constraints that have not been tried, or -1
    last: Ints  # (M,) the last of them
    edge: Ints  # (M,) the last edge from it, or -1
    queue: Ints  # (M,) working memory


class _Pools(NamedTuple):
    """The constraints and edges of configurations, and the state of the search."""

    constraints: Ints  # (L, 5) parent, robot, vertex, number of parents, next
    edges: Ints  # (E, 2) the configuration that it leads to, the previous edge
    table: Ints  # (H,) configurations by hash, or -1; H is a power of two, more than 2 M
    state: _Longs  # (7,) top of the stack, three counts, made, the goals or -1, loaded


@kernel
def _hash(at: Array) -> int:
    found = np.int64(1469598103934665603)
    for i in range(at.shape[0]):
        found = (found ^ np.int64(at[i])) * np.int64(1099511628211)
        found ^= found >> 29
    return found  # type: ignore[return-value]  # numba's integers


@kernel
def _place(nodes: _Nodes, table: Array, at: Array, code: int) -> int:
    """Return the index of a configuration in the hash table, of an empty entry if it is new."""
    mask = table.shape[0] - 1
    place = code & mask
    while table[place] >= 0:
        node = table[place]
        if nodes.hash[node] == code:
            same = True
            for i in range(at.shape[0]):
                if nodes.at[node, i] != at[i]:
                    same = False
                    break
            if same:
                break
        place = (place + 1) & mask
    return int(place)


@kernel
def _fill_table(nodes: _Nodes, pools: _Pools) -> None:
    """Enter all configurations into an empty hash table."""
    for node in range(pools.state[_NODES]):
        pools.table[_place(nodes, pools.table, nodes.at[node], nodes.hash[node])] = node


@kernel
def _unstack(nodes: _Nodes, state: Array, node: int) -> None:
    if not nodes.stacked[node]:
        return
    above, below = nodes.above[node], nodes.below[node]
    if above >= 0:
        nodes.below[above] = below
    else:
        state[_TOP] = below
    if below >= 0:
        nodes.above[below] = above
    nodes.stacked[node] = False


@kernel
def _stack(nodes: _Nodes, state: Array, node: int) -> None:
    """Put a configuration on top of the stack, wherever it was."""
    _unstack(nodes, state, node)
    top = state[_TOP]
    nodes.above[node], nodes.below[node] = -1, top
    if top >= 0:
        nodes.above[top] = node
    state[_TOP] = node
    nodes.stacked[node] = True


@kernel
def _constrain_more(
    nodes: _Nodes, pools: _Pools, node: int, parent: int, who: int, to: int
) -> None:
    """Add a constraint to be tried; with a parent of -1, the empty one."""
    new = pools.state[_CONSTRAINTS]
    pools.state[_CONSTRAINTS] += 1
    entry = pools.constraints[new]
    entry[_PARENT], entry[_WHO], entry[_TO], entry[_NEXT] = parent, who, to, -1
    entry[_DEPTH] = 0 if parent < 0 else pools.constraints[parent, _DEPTH] + 1
    if nodes.first[node] < 0:
        nodes.first[node] = new
    else:
        pools.constraints[nodes.last[node], _NEXT] = new
    nodes.last[node] = new


@kernel
def _add_edge(nodes: _Nodes, pools: _Pools, node: int, to: int) -> None:
    new = pools.state[_EDGES]
    pools.state[_EDGES] += 1
    pools.edges[new, 0], pools.edges[new, 1] = to, nodes.edge[node]
    nodes.edge[node] = new


@kernel
def _add_node(
    terrain: Terrain, robots: Robots, nodes: _Nodes, pools: _Pools, parent: int, code: int
) -> int:
    """Add the configuration at the end of `nodes.at`, stack it, and return its number."""
    new = int(pools.state[_NODES])
    pools.state[_NODES] += 1
    at, longest = nodes.at[new], 0
    for i in range(at.shape[0]):
        left = path_length(terrain, robots, i, at[i])
        longest = max(longest, left)
        before = 0 if parent < 0 else nodes.away[parent, i]
        nodes.away[new, i] = 0 if left == 0 else before + 1
    nodes.parent[new], nodes.hash[new], nodes.left[new] = parent, code, longest
    nodes.steps[new] = 0 if parent < 0 else nodes.steps[parent] + 1
    nodes.first[new] = nodes.edge[new] = -1
    nodes.stacked[new] = False
    _constrain_more(nodes, pools, new, -1, -1, -1)
    _stack(nodes, pools.state, new)
    pools.table[_place(nodes, pools.table, at, code)] = new
    if longest == 0:
        pools.state[_GOAL] = new
    return new


@kernel
def _load(terrain: Terrain, robots: Robots, nodes: _Nodes, before: int, node: int) -> None:
    """Load a configuration's positions, and queue the robots, always in the same order."""
    at, top = nodes.at[node], robots.counts.shape[0] - 1
    if before >= 0:
        for i in range(at.shape[0]):
            terrain.cells[nodes.at[before, i]]["now"] = -1
    for i in range(at.shape[0]):
        terrain.cells[at[i]]["now"] = i
        robots.records[i]["urgency"] = top - min(nodes.away[node, i], top)
    line_up(robots, 0)


@kernel
def _constrain(terrain: Terrain, robots: Robots, pools: _Pools, at: Array, constraint: int) -> bool:
    """Settle the moves of the constraints; return True if that is possible."""
    while pools.constraints[constraint, _PARENT] >= 0:
        entry = pools.constraints[constraint]
        who, to = entry[_WHO], entry[_TO]
        other = terrain.cells[to]["now"]
        if terrain.cells[to]["taken"] >= 0:
            return False
        if other >= 0 and other != who and robots.records[other]["next"] == at[who]:
            return False  # They would swap
        take(terrain.cells, robots.records, who, to)
        constraint = entry[_PARENT]
    return True


@kernel
def _branch(
    terrain: Terrain, robots: Robots, nodes: _Nodes, pools: _Pools, node: int, constraint: int
) -> None:
    """Add constraints of one more robot to each of its vertices, in random order."""
    depth = pools.constraints[constraint, _DEPTH]
    if depth >= robots.records.shape[0]:
        return
    who, choices, kept = robots.records[depth]["queue"], robots.stack[0], 0
    here = nodes.at[node, who]
    for k in range(7):
        vertex = neighbor(terrain.grid, terrain.cells[here], here, k)
        if vertex < 0 or terrain.cells[vertex]["taken"] == WALL:
            continue
        other = draw(robots.random) % (kept + 1)
        choices[kept] = choices[other]
        choices[other] = vertex
        kept += 1
    for k in range(kept):
        _constrain_more(nodes, pools, node, constraint, who, choices[k])


@kernel
def _shorten(nodes: _Nodes, pools: _Pools, begin: int) -> None:
    """Update the steps and parents of successors that are now nearer to the starts."""
    nodes.queue[0] = begin
    head, tail = 0, 1
    while head < tail:
        node = nodes.queue[head]
        head += 1
        edge, steps = nodes.edge[node], nodes.steps[node] + 1
        while edge >= 0:
            to = pools.edges[edge, 0]
            if steps < nodes.steps[to]:
                nodes.steps[to], nodes.parent[to] = steps, node
                nodes.queue[tail] = to
                tail += 1
                goal = pools.state[_GOAL]
                if goal < 0 or steps + nodes.left[to] < nodes.steps[goal]:
                    _stack(nodes, pools.state, to)
            edge = pools.edges[edge, 1]


@kernel
def _make(terrain: Terrain, robots: Robots, nodes: _Nodes, pools: _Pools, node: int) -> None:
    """Make one more successor, if the next constraint allows one."""
    at, count = nodes.at[node], nodes.at.shape[1]
    constraint = nodes.first[node]
    nodes.first[node] = pools.constraints[constraint, _NEXT]
    pools.state[_MADE] += 1
    for i in range(count):
        robots.records[i]["next"] = -1
    made = _constrain(terrain, robots, pools, at, constraint)
    if made:
        _branch(terrain, robots, nodes, pools, node, constraint)
        made = settle_rest(terrain, robots, at, False)
    new = nodes.at[pools.state[_NODES]]
    for i in range(count):
        new[i] = robots.records[i]["next"]
        if new[i] >= 0:
            terrain.cells[new[i]]["taken"] = -1
    if made:
        _keep(terrain, robots, nodes, pools, node)


@kernel
def _keep(terrain: Terrain, robots: Robots, nodes: _Nodes, pools: _Pools, node: int) -> None:
    """Add the configuration at the end of `nodes.at`, or if it is known, continue from there."""
    new = nodes.at[pools.state[_NODES]]
    code = _hash(new)
    known = pools.table[_place(nodes, pools.table, new, code)]
    if known < 0:
        _add_edge(nodes, pools, node, _add_node(terrain, robots, nodes, pools, node, code))
        return
    _add_edge(nodes, pools, node, known)
    if nodes.steps[node] + 1 < nodes.steps[known]:
        _shorten(nodes, pools, node)
    again = 0 if draw(robots.random) % _RESTART == 0 else known
    _stack(nodes, pools.state, again)


@kernel
def _search(terrain: Terrain, robots: Robots, nodes: _Nodes, pools: _Pools, most: int) -> int:
    """Make configurations until `most` were made, the stack is empty, or the memory is full.

    It also ends when a first or a shorter plan is found.
    """
    state = pools.state
    known = state[_GOAL]
    while state[_TOP] >= 0:
        node, goal = state[_TOP], state[_GOAL]
        if goal != known or state[_MADE] >= most:
            return _ENDED
        late = goal >= 0 and nodes.steps[node] + nodes.left[node] >= nodes.steps[goal]
        if late or nodes.first[node] < 0:
            _unstack(nodes, state, node)
            continue
        full = state[_NODES] + 1 >= nodes.at.shape[0]
        full = full or state[_CONSTRAINTS] + 8 >= pools.constraints.shape[0]
        if full or state[_EDGES] + 1 >= pools.edges.shape[0]:
            return _FULL
        if state[_LOADED] != node:
            _load(terrain, robots, nodes, state[_LOADED], node)
            state[_LOADED] = node
        _make(terrain, robots, nodes, pools, node)
    return _EXHAUSTED


class Lacam:
    """The search on one instance, which can be continued.

    It does not depend on time: the same seed makes the same configurations in the same order.
    """

    def __init__(self, instance: GridInstance, seed: int) -> None:
        count = len(instance.starts)
        generator = np.random.default_rng(seed)
        self._terrain = survey(instance)
        self._robots = new_robots(instance, instance.lower_bound + _SLACK)
        order = generator.permutation(count)
        far_first = np.argsort(-instance.lengths[order], kind="stable")
        self._robots.records["order"] = order[far_first]
        self._robots.random[0] = generator.integers(2**62)
        room = max(16, min(1024, 4 * _MORE_ENTRIES // count))
        self._nodes = _new_nodes(room, count)
        self._pools = _Pools(
            constraints=np.empty((8 * room, 5), dtype=np.int32),
            edges=np.empty((2 * room, 2), dtype=np.int32),
            table=np.full(_table_size(room), -1, dtype=np.int32),
            state=np.array([-1, 0, 0, 0, 0, -1, -1], dtype=np.int64),
        )
        self._search = entry_point(_search, *self._memory, 0)  # with the kernels that it calls
        self._nodes.at[0] = numbers(instance.starts, instance.shape)
        code = _hash(self._nodes.at[0])
        _add_node(*self._memory, -1, code)
        self.exhausted = False
        """True if all has been tried: the plan is the shortest, or none exists."""

    @property
    def _memory(self) -> tuple[Terrain, Robots, _Nodes, _Pools]:
        return self._terrain, self._robots, self._nodes, self._pools

    @property
    def made(self) -> int:
        """The number of attempts to make a configuration."""
        return int(self._pools.state[_MADE])

    @property
    def steps(self) -> int | None:
        """The makespan of the best plan so far, or None."""
        goal = int(self._pools.state[_GOAL])
        return None if goal < 0 else int(self._nodes.steps[goal])

    def run(self, most: int) -> None:
        """Continue until `most` configurations have been made, or a first or shorter plan."""
        while True:
            why = self._search(*self._memory, most)
            if why != _FULL:
                break
            self._grow()
        self.exhausted = why == _EXHAUSTED

    def _grow(self) -> None:
        """Double the arrays that are full."""
        nodes, pools = self._nodes, self._pools
        if pools.state[_NODES] + 1 >= len(nodes.at):
            self._nodes = _Nodes(*(_doubled(array) for array in nodes))
            table = np.full(_table_size(len(self._nodes.at)), -1, dtype=np.int32)
            pools = pools._replace(table=table)
            _fill_table(self._nodes, pools)
        if pools.state[_CONSTRAINTS] + 8 >= len(pools.constraints):
            pools = pools._replace(constraints=_doubled(pools.constraints))
        if pools.state[_EDGES] + 1 >= len(pools.edges):
            pools = pools._replace(edges=_doubled(pools.edges))
        self._pools = pools

    def paths(self) -> Paths:
        """Return the vertices (T + 1, n) of the best plan so far."""
        chain, node = [], int(self._pools.state[_GOAL])
        while node >= 0:
            chain.append(node)
            node = int(self._nodes.parent[node])
        return np.ascontiguousarray(self._nodes.at[chain[::-1]])


def _new_nodes(room: int, count: int) -> _Nodes:
    kinds: dict[str, Any] = {"hash": np.int64, "stacked": np.bool_}
    shapes = {"at": (room, count), "away": (room, count)}
    arrays: list[Array] = [
        np.empty(shapes.get(name, (room,)), kinds.get(name, np.int32)) for name in _Nodes._fields
    ]
    return _Nodes(*arrays)


def _doubled(array: Array) -> Array:
    return np.concatenate([array, np.empty_like(array)])


def _table_size(room: int) -> int:
    return 1 << (2 * room).bit_length()


def best_plan(instance: GridInstance, seed: int, clock: PlanningClock) -> Paths:
    """Return the best plan (T + 1, n) of the search within its configurations and the time limit.

    By default it makes at most 1,000,000 configurations before the first plan: fewer for more than
    100 robots, as many as fit into 0.8 GB, but enough for a plan of twice the lower bound. After
    the first plan it makes as many again, or 1,000 more (fewer for more than 1,000 robots).

    Raises:
        NoPlanExists: All configurations have been searched.
        PlanTimeout: The time limit ended before the first plan.
        PlanNotFound: No plan was found within the configurations.
    """
    count, bound = len(instance.starts), instance.lower_bound
    most = clock.configurations or max(min(_MOST, _MOST_ENTRIES // count), 2 * bound + 100)
    search = Lacam(instance, seed)
    while not search.exhausted and search.made < most and search.steps != bound:
        if clock.remaining <= 0:
            break
        first = search.steps is None
        search.run(min(most, search.made + max(1, _GLANCE // count)))
        if first and search.steps is not None and not clock.limited:
            most = search.made + max(search.made, min(_MORE, _MORE_ENTRIES // count))
    if search.steps is not None:
        return search.paths()
    if search.exhausted:
        raise NoPlanExists(
            f"no plan exists: the search has tried all moves of the {count} robots in the part of "
            f"the grid with {instance.starts[0].tolist()} ({search.made} configurations)"
        )
    clock.check("lacam")
    raise PlanNotFound(
        f"lacam has found no plan within {search.made} configurations of {count} robots, and has "
        "not proven that none exists; try another seed, or more configurations"
    )
