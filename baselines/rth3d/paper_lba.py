"""RTH3D-LBA as published (Sec. III-C): matchings height by height, balancing of least distance.

Matchings: for one height after another, the perfect matching of columns and colors with the least
largest shift among the remaining items (eq. 1, whose C_zi at lambda = 0 the paper does not define:
here it is the shift along z, |z - s1.z|); then the matchings are assigned to heights so that their
largest shift is the least (eq. 2). Both are linear bottleneck assignments.

Balancing: a flow of least cost from robots to slots, with a cost of one per edge. Robots, which
have no labels here, follow its edges from vertex to vertex; as the flow has no rings, none waits
for ever (Yu and LaValle, "Distance Optimal Formation Control on Graphs with a Tight Convergence
Time Guarantee", CDC 2012, [53] of the paper).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, NoHighways, Vertices
from swarm_envs.baselines.rth3d.path_lengths import FAR, Ints, Neighbors
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray


def assign_levels_in_turn(aims: npt.NDArray[np.integer], real: npt.NDArray[np.bool_]) -> Ints:
    """Return levels (G, K, D) of all items, as `assign_levels`, by the paper's two assignments."""
    return np.stack([_table_levels(*table) for table in zip(aims, real, strict=True)])


def _table_levels(aims: Ints, real: npt.NDArray[np.bool_]) -> Ints:
    columns, size = aims.shape
    every, places = np.arange(columns), np.arange(size, dtype=np.int32)
    shifts = np.abs(places[:, None] - places).astype(np.int32)  # by level and place
    costs, own = np.where(real, shifts[:, None], 0), np.empty((size, columns), dtype=np.int64)
    left, worst = np.zeros(aims.shape, dtype=np.int32), np.empty((size, size), dtype=np.int32)
    for k in range(size):  # Items that have a level already cost more than any shift
        own[k] = _least_bottleneck(np.ascontiguousarray(aims), np.maximum(costs[k], left))
        left[every, own[k]] = size
        worst[k] = costs[:, every, own[k]].max(axis=1)
    levels = _least_bottleneck(np.tile(places, (size, 1)), worst)
    found = np.empty(aims.shape, dtype=np.int32)
    np.put_along_axis(found, own.T, np.tile(levels, (columns, 1)), axis=1)
    return found


def _least_bottleneck(aims: Ints, costs: Ints) -> Ints:
    """Return each column's item (K,) in a perfect matching whose largest cost (K, D) is least."""
    match = np.full(len(aims), -1, dtype=np.int32)
    _match(aims, costs, match)
    return np.where(aims == match[:, None], costs, FAR).argmin(axis=1).astype(np.int32)


@kernel
def _match(aims: Array, costs: Array, match: Array) -> None:
    """Match each column to an aim, allowing items of higher and higher costs."""
    columns, size = aims.shape
    holder = np.full(columns, -1, dtype=np.int32)
    stack, arcs = np.empty(columns, dtype=np.int32), np.empty(columns, dtype=np.int32)
    matched, most = 0, 0
    while matched < columns:
        before, seen = matched, np.zeros(columns, dtype=np.bool_)
        arcs[:] = 0
        for c in range(columns):
            if match[c] >= 0:
                continue
            stack[0], top = c, 0
            while top >= 0:
                at = stack[top]
                if arcs[at] == size:
                    top -= 1
                    continue
                item, arcs[at] = arcs[at], arcs[at] + 1
                aim = aims[at, item]
                if costs[at, item] > most or seen[aim]:
                    continue
                seen[aim] = True
                if holder[aim] >= 0:
                    top += 1
                    stack[top] = holder[aim]
                    continue
                for k in range(top + 1):
                    aim = aims[stack[k], arcs[stack[k]] - 1]
                    holder[aim], match[stack[k]] = stack[k], aim
                matched += 1
                break
        if matched == before:
            most += 1


@kernel
def _excess(table: Array, flow: Array, price: Array, v: int, d: int) -> int:
    """Return the reduced cost of a residual edge: 0, 1 or 2."""
    u = table[v, d]
    return int(price[v] - price[u] + (-1 if flow[u, d ^ 1] > 0 else 1))


@kernel
def _set_prices(
    table: Array, waiting: Array, sinks: Array, flow: Array, price: Array, far: Array, work: Array
) -> bool:
    """Update prices (V,) so that paths to nearest free sinks are free; return False without one."""
    seen, ends, known = work[3], np.zeros(3, dtype=np.int64), waiting.shape[0]
    for k in range(known):
        far[waiting[k]] = 0
        seen[k] = work[0, k] = waiting[k]
    ends[0], level, least = known, 0, FAR
    while level < least and ends.sum() > 0:
        now, k = level % 3, 0
        while k < ends[now]:
            v = work[now, k]
            k += 1
            if far[v] != level:
                continue
            if sinks[v]:
                least = min(least, level + price[v])
            for d in range(6):
                u = table[v, d]
                if u < 0:
                    continue
                cost = level + _excess(table, flow, price, v, d)
                if cost < far[u]:
                    if far[u] == FAR:
                        seen[known] = u
                        known += 1
                    far[u] = cost
                    work[cost % 3, ends[cost % 3]] = u
                    ends[cost % 3] += 1
        ends[now] = 0
        level += 1
    for k in range(known):
        price[seen[k]] += min(far[seen[k]] - least, 0)
        far[seen[k]] = FAR
    return bool(least < FAR)


@kernel
def _send_at_price(
    table: Array, waiting: Array, sinks: Array, flow: Array, price: Array, arcs: Array, stack: Array
) -> int:
    """Send waiting robots to free sinks at no reduced cost; return how many still wait."""
    arcs[:] = -1  # Vertices that have not been tried
    left = 0
    for begin in waiting:
        top, stack[0] = 0, begin
        arcs[begin] = 0
        while top >= 0:
            v = stack[top]
            d = arcs[v]
            if sinks[v] and price[v] == 0:
                break
            if d == 6:
                top -= 1
                continue
            arcs[v] += 1
            u = table[v, d]
            if u >= 0 and arcs[u] < 0 and _excess(table, flow, price, v, d) == 0:
                top += 1
                stack[top], arcs[u] = u, 0
        if top < 0:
            waiting[left] = begin
            left += 1
            continue
        sinks[stack[top]] = False
        for k in range(top):
            v, u, d = stack[k], stack[k + 1], arcs[stack[k]] - 1
            if flow[u, d ^ 1] > 0:
                flow[u, d ^ 1] -= 1
            else:
                flow[v, d] += 1
    return left


@kernel
def _push(table: Array, flow: Array, at: Array, holder: Array, claim: Array, aim: Array) -> None:
    """Move all by one step along the flow, in place."""
    for i in range(at.shape[0]):
        most, aim[i] = 0, -1
        for k in range(6):
            if flow[at[i], k] > most and claim[table[at[i], k]] < 0:
                most, aim[i] = flow[at[i], k], k
        if aim[i] >= 0:
            claim[table[at[i], aim[i]]] = i
    changed = True
    while changed:  # Robots that would follow a waiting one wait too
        changed = False
        for i in range(at.shape[0]):
            other = -1 if aim[i] < 0 else holder[table[at[i], aim[i]]]
            if other >= 0 and aim[other] < 0:
                claim[table[at[i], aim[i]]] = aim[i] = -1
                changed = True
    for i in range(at.shape[0]):
        if aim[i] >= 0:
            if holder[at[i]] == i:
                holder[at[i]] = -1
            flow[at[i], aim[i]] -= 1
            at[i] = table[at[i], aim[i]]
            claim[at[i]] = -1
            holder[at[i]] = i


def balance_by_distance(
    table: Neighbors,
    starts: Vertices,
    sinks: BoolArray,
    check: Callable[[], None] = lambda: None,
) -> Paths:
    """Return paths of the least total distance that lead every robot to a sink of its own.

    The arguments and paths are those of `balance`.

    Raises:
        NoHighways: The sinks cannot be reached.
    """
    total, order = len(table), np.argsort(starts)  # Only the set matters, not the labels
    at = starts[order].astype(np.int32)
    flow, price = np.zeros((total, 6), dtype=np.int32), np.zeros(total, dtype=np.int32)
    far, room, waiting = np.full(total, FAR, dtype=np.int32), sinks.copy(), at.copy()
    work, arcs = np.empty((4, 7 * total), dtype=np.int32), np.empty(total, dtype=np.int8)
    while len(waiting):
        check()
        if not _set_prices(table, waiting, room, flow, price, far, work):
            raise NoHighways("robots cannot get to slots of the highways; use method='auto'")
        left = _send_at_price(table, waiting, room, flow, price, arcs, work[0])
        waiting = waiting[:left]
    holder, claim = np.full((2, total), -1, dtype=np.int32)
    holder[at] = np.arange(len(at))
    paths, aim = [at.copy()], np.empty(len(at), dtype=np.int32)
    while flow[at].any():
        check()
        _push(table, flow, at, holder, claim, aim)
        paths.append(at.copy())
    found = np.empty((len(paths), len(at)), dtype=np.int32)
    found[:, order] = paths
    return found
