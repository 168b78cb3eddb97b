"""UnlabeledMRPP: from any configuration to slots, any robot to any slot (Algorithm 1, line 2).

The robots are one flow over a few time steps ([51] of the paper): every vertex at every step is a
node through which one unit may pass, and the slots at the last step are sinks. A maximum flow that
contains all robots is a plan. The number of steps is increased from 1 to 10, and then by a fifth at
most, so that makespans of up to 10 are the least possible. The plan depends on the *set* of starts
alone, so that equal sets get the same paths.

If goals are reflected starts (rings, Sec. V-C, and mirrors), the paths of the goals are the
reflected paths of the starts: whole columns then belong into columns, and two shuffles vanish.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count as _count_up

import numpy as np

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Array, GridInstance, NoHighways, Vertices
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.highways import Highways, reflected, reflection
from swarm_envs.baselines.rth3d.path_lengths import STAY, Neighbors, neighbor_table
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray

_UNUSED = -1
_MOST_NODES = 2**29
_FAR = 2**30


@kernel
def _label(
    table: Array,
    used_out: Array,
    used_in: Array,
    label: Array,
    sink: Array,
    queue: Array,
    steps: int,
) -> None:
    """Label the nodes with their distance to a free sink in the residual graph.

    A node is ((t V + v) 2 + side), where flow enters at side 0 and leaves at side 1; `label` has a
    row for each side.
    """
    total = table.shape[0]
    label[:] = _FAR
    tail = 0
    for v in range(total):
        place = steps * total + v
        if sink[v] and used_in[place] < 0:
            label[0, place] = 1
            queue[tail] = 2 * place
            tail += 1
    head = 0
    while head < tail:
        node = queue[head]
        head += 1
        side, place = node & 1, node >> 1
        farther = label[side, place] + 1
        if side == 0:
            v = place % total
            for arc in range(7):
                u = table[v, arc]
                before = place - total + u - v
                if u < 0 or before < 0 or label[1, before] < _FAR:
                    continue
                if used_out[before] != (arc ^ 1 if arc < 6 else arc):
                    label[1, before] = farther
                    queue[tail] = 2 * before + 1
                    tail += 1
            passes = place < used_out.shape[0] and used_in[place] >= 0
            if passes and label[1, place] == _FAR:  # Flow that passes through may be taken back
                label[1, place] = farther
                queue[tail] = 2 * place + 1
                tail += 1
            continue
        if place >= total and used_in[place] < 0 and label[0, place] == _FAR:
            label[0, place] = farther
            queue[tail] = 2 * place
            tail += 1
        if used_out[place] >= 0:  # By taking back the flow that continues
            v = place % total
            after = place + total + table[v, used_out[place]] - v
            if label[0, after] == _FAR:
                label[0, after] = farther
                queue[tail] = 2 * after
                tail += 1


@kernel
def _augment(
    table: Array,
    used_out: Array,
    used_in: Array,
    label: Array,
    sink: Array,
    pending: Array,
    path: Array,
    arcs: Array,
    steps: int,
) -> int:
    """Send waiting robots to sinks, near ones first, along paths that share no node.

    Returns the number of robots that were sent, or -1 if one can reach no sink. Paths need not be
    shortest: a search that enters each node once finds paths for nearly all robots.
    """
    total = table.shape[0]
    sent = 0
    for s in range(total):
        if not pending[s]:
            continue
        if label[1, s] == _FAR:
            return -1
        depth = 0
        path[0] = 2 * s + 1
        while depth >= 0:
            node = path[depth]
            side, place = node & 1, node >> 1
            v, came = place % total, used_in[place]
            label[side, place] = _FAR
            is_last = place - v == steps * total
            if is_last and sink[v] and came < 0:
                _send(used_out, used_in, path, arcs, depth)
                pending[s] = False
                sent += 1
                break
            lowest = _FAR
            if side == 1:
                for arc in range(7):
                    u = table[v, arc]
                    if u < 0 or used_out[place] == arc:
                        continue
                    after = place + total + u - v
                    if label[0, after] < lowest:
                        lowest = label[0, after]
                        arcs[depth], path[depth + 1] = arc, 2 * after
                passes = place >= total and came >= 0
                if passes and label[0, place] < lowest:  # Take back the flow that passes through
                    lowest = label[0, place]
                    arcs[depth], path[depth + 1] = 7, 2 * place
            elif came >= 0:  # Only by taking back the flow that enters
                before = place - total + (table[v, came ^ 1] if came < 6 else v) - v
                lowest = label[1, before]
                arcs[depth], path[depth + 1] = 0, 2 * before + 1
            elif not is_last:
                lowest = label[1, place]
                arcs[depth], path[depth + 1] = 0, 2 * place + 1
            depth += 1 if lowest < _FAR else -1
    return sent


@kernel
def _send(used_out: Array, used_in: Array, stack: Array, arcs: Array, depth: int) -> None:
    """Change the flow along a path."""
    for k in range(depth + 1):
        side, place = stack[k] & 1, stack[k] >> 1
        if side == 1 and k < depth:
            if arcs[k] == 7:
                used_out[place] = -1
                used_in[place] = -1
            else:
                used_out[place] = arcs[k]
                used_in[stack[k + 1] >> 1] = arcs[k]


@kernel
def _without_swaps(table: Array, used_out: Array, used_in: Array, steps: int) -> None:
    """Let two units that would swap stay, which is equivalent as they have no labels."""
    total = table.shape[0]
    for t in range(steps):
        for v in range(total):
            here = t * total + v
            d = used_out[here]
            if d < 0 or d == 6:
                continue
            there = here + table[v, d] - v
            if used_out[there] == d ^ 1:
                used_out[here] = used_out[there] = 6
                used_in[here + total] = used_in[there + total] = 6


@kernel
def _follow(table: Array, used_out: Array, starts: Array, paths: Array) -> None:
    """Write the vertices of the unit that leaves each start."""
    total = table.shape[0]
    for i in range(starts.shape[0]):
        paths[0, i] = starts[i]
    for t in range(paths.shape[0] - 1):
        for i in range(starts.shape[0]):
            v = paths[t, i]
            paths[t + 1, i] = table[v, used_out[t * total + v]]


class _Flow:
    """The present flow over a number of steps."""

    def __init__(self, table: Neighbors, starts: Vertices, sinks: BoolArray) -> None:
        self.table, self.sinks = table, sinks
        self.total = len(table)
        self.steps = 0
        self.pending = np.zeros(self.total, dtype=np.bool_)
        self.pending[starts] = True
        self.settled = self.pending & sinks
        self.pending &= ~sinks
        self.out = np.full(0, _UNUSED, dtype=np.int8)
        self.come = np.full(self.total, _UNUSED, dtype=np.int8)

    def lengthen(self, steps: int) -> None:
        """Increase the number of steps; units that have arrived stay."""
        more = steps - self.steps
        stay = np.where(self.settled, np.int8(STAY), np.int8(_UNUSED))
        self.out = np.concatenate([self.out, np.tile(stay, more)])
        self.come = np.concatenate([self.come, np.tile(stay, more)])
        self.steps = steps

    def fill(self, check: Callable[[], None]) -> None:
        """Send as many robots as can arrive in time."""
        nodes = 2 * (self.steps + 1) * self.total
        label = np.empty((2, nodes // 2), dtype=np.int32)
        queue, arcs = np.empty(nodes, dtype=np.int32), np.empty(nodes, dtype=np.int8)
        flow = (self.table, self.out, self.come, label, self.sinks)
        while self.pending.any():
            check()
            _label(*flow, queue, self.steps)
            if _augment(*flow, self.pending, queue, arcs, self.steps) < 0:
                break
        last = self.come[self.steps * self.total :]
        self.settled = last >= 0


def balance(
    table: Neighbors,
    starts: Vertices,
    sinks: BoolArray,
    check: Callable[[], None] = lambda: None,
) -> Paths:
    """Return paths that lead every robot to some sink of its own in the fewest steps.

    They lead from starts (n,), all different, to at least as many sinks (V,), on the grid of a
    `neighbor_table`. `check` is called now and then, and may raise to end the work.

    Returns:
        (T + 1, n) vertices. T is the least possible up to 10, and above that at most a fifth more.

    Raises:
        NoHighways: The sinks cannot be reached, or only in more steps than a flow may have.
    """
    flow = _Flow(table, starts, sinks)
    for steps in _count_up():
        if not flow.pending.any():
            break
        if steps == 0 or (steps > 8 and steps % (steps // 5)):
            continue
        if 2 * (steps + 1) * flow.total > _MOST_NODES:
            raise NoHighways(
                f"after {flow.steps} steps {int(flow.pending.sum())} robots still reach no slot; "
                "the starts or goals are too unevenly spread over so large a grid",
            )
        flow.lengthen(steps)
        flow.fill(check)
    _without_swaps(table, flow.out, flow.come, flow.steps)
    paths = np.empty((flow.steps + 1, len(starts)), dtype=np.int32)
    _follow(table, flow.out, np.ascontiguousarray(starts), paths)
    return paths


@dataclass(frozen=True, eq=False)
class Balanced:
    """Paths into the slots, from the starts to S1 and from the goals to G1."""

    first: Paths  # (T1 + 1, n) from the starts
    last: Paths  # (T2 + 1, n) from the goals
    image: Vertices  # (V,) the reflection from `first` to `last`; the identity if there is none


def unlabeled_mrpp(
    highways: Highways,
    instance: GridInstance,
    balance: Callable[..., Paths],
    clock: PlanningClock,
) -> Balanced:
    """Return balanced starts and goals (Algorithm 1, line 2), reflected if goals are."""
    table = neighbor_table(highways.shape, highways.obstacles)
    starts, goals = (highways.vertices(p) for p in (instance.starts, instance.goals))
    sinks = np.zeros(len(table), dtype=np.bool_)
    sinks[highways.slots] = True
    with clock.phase("balance starts") as record:
        first = balance(table, starts, sinks, lambda: clock.check("balance starts"))
        record(len(first) - 1)
    with clock.phase("balance goals") as record:
        image = reflection(highways, starts, goals)
        if image is None:
            last = balance(table, goals, sinks, lambda: clock.check("balance goals"))
        else:
            last = reflected(first, image, goals)
        record(len(last) - 1)
    return Balanced(first, last, np.arange(len(table), dtype=np.int32) if image is None else image)
