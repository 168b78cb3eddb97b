"""LaCAM* in each connected part of a grid, and orders of robots that a part makes impossible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import GridInstance, NoPlanExists, Vertices, numbers
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.lacam import best_plan
from swarm_envs.baselines.rth3d.path_lengths import Neighbors, neighbor_table
from swarm_envs.state import IntArray


class Part(NamedTuple):
    """A connected part of the grid in which a robot has to move."""

    vertices: Vertices  # (V',) its vertices
    robots: IntArray  # (n',) the robots in it
    instance: GridInstance  # These robots on the whole grid


def connected_parts(instance: GridInstance) -> list[Part]:
    """Return the connected parts of the free vertices where not every robot is at its goal.

    Raises:
        NoPlanExists: A robot's start and goal are in different parts.
    """
    assert instance.lengths.max() > 0  # `lengths` raises if a robot cannot get to its goal
    names = label(~instance.obstacles)[0].ravel()
    home = names[numbers(instance.starts, instance.shape)]
    moving = np.unique(home[instance.lengths > 0])
    found = []
    for name in moving:
        robots = np.flatnonzero(home == name)
        part = instance
        if len(robots) < len(home):
            part = replace(instance, starts=instance.starts[robots], goals=instance.goals[robots])
        found.append(Part(np.flatnonzero(names == name).astype(np.int32), robots, part))
    return found


def search_parts(instance: GridInstance, seed: int, clock: PlanningClock) -> Paths:
    """Return the plan (T + 1, n) of LaCAM* in each part by itself, compacted.

    Raises:
        NoPlanExists: A part has none.
        PlanNotFound: None was found in a part.
        PlanTimeout: The time limit ended before there was a plan.
    """
    parts = connected_parts(instance)
    check_order(instance, parts)
    with clock.phase("lacam") as record:
        found = [best_plan(part.instance, seed, clock) for part in parts]
        steps = max(len(paths) for paths in found)
        whole = np.tile(numbers(instance.starts, instance.shape), (steps, 1))
        for part, paths in zip(parts, found, strict=True):
            whole[: len(paths), part.robots] = paths
            whole[len(paths) :, part.robots] = paths[-1]
        whole = compact(whole, int(np.prod(instance.shape)))
        record(len(whole) - 1)
    return whole


def check_order(instance: GridInstance, parts: Sequence[Part]) -> None:
    """Raise NoPlanExists if the order of robots along a line or around a ring would change."""
    table = neighbor_table(instance.shape, instance.obstacles)
    for part in parts:
        sides = (table[part.vertices, :6] >= 0).sum(axis=1)
        if sides.max() > 2:
            continue
        ends = part.vertices[sides == 1]
        line = _in_line(table, int(ends[0] if len(ends) else part.vertices[0]))
        place = np.zeros(len(table), dtype=np.int64)
        place[line] = np.arange(len(line))
        first, last = (
            part.robots[np.argsort(place[numbers(p[part.robots], instance.shape)])]
            for p in (instance.starts, instance.goals)
        )
        if not len(ends):
            last = np.roll(last, -int(np.flatnonzero(last == first[0])[0]))
        wrong = np.flatnonzero(first != last)
        if len(wrong):
            shape = "line" if len(ends) else "ring"
            raise NoPlanExists(
                f"no plan exists: on a {shape} of {len(line)} vertices robots cannot pass, "
                f"but robots {first[wrong[0]]} and {last[wrong[0]]} would have to; give them goals "
                "in the order of their starts"
            )


def _in_line(table: Neighbors, begin: int) -> list[int]:
    """Return the vertices of a line or ring from `begin` on, in order."""
    line, before = [begin], -1
    while True:
        onward = [int(u) for u in table[line[-1], :6] if u >= 0 and u != before]
        if not onward or onward[0] == begin:
            return line
        before = line[-1]
        line.append(onward[0])
