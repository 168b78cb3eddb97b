"""The inner loop of stage 1: grow a tree until it reaches the goal below a cost (lines 4 to 15)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.flight import INVALID, forces_allowed, step
from swarm_envs.baselines.neural_swarm.planner.kd_tree import nearest
from swarm_envs.baselines.neural_swarm.planner.scene import Scene, Work
from swarm_envs.baselines.neural_swarm.planner.tree import (
    NONE,
    Tree,
    at_goal,
    extend,
    finish,
    load,
    outlook,
    plant,
    put_point,
    reach,
    settle,
    write_state,
)
from swarm_envs.compiled import kernel, part
from swarm_envs.state import FloatArray

FEW = 5
"""Random nodes among which the most promising is taken."""
SPREAD, SPEED_SPREAD = 0.6, 0.8
"""Largest standard deviations of samples about the guide, m and m/s; most are far closer."""
LEG = 10
"""Edges in the longest motion towards a sample that lies in the past."""


class Chances(NamedTuple):
    """How often the search does what."""

    goal: float = 0.5
    """To try a flight from a new node straight to the goal."""
    action: float = 0.3
    """To hold a random action for one edge; else towards the sample's position."""
    promising: float = 0.4
    """To start from the most promising of a few random nodes; else from the nearest to a sample."""
    guided: float = 0.7
    """To sample near the guide; else uniformly."""


@part
def sample(
    scene: Scene,
    tree: Tree,
    bound: float,
    chances: Chances,
    rng: np.random.Generator,
    out: FloatArray,
) -> tuple[int, float]:
    """Draw a state (6,) into `out`, and a time and a cost, from the state-cost space."""
    last = scene.position.shape[0] - 1
    knot = rng.integers(1, last + 1)
    guided, wide = rng.random() < chances.guided, rng.random() ** 3
    for k in range(3):
        if guided:
            out[k] = scene.guide[knot, k] + wide * SPREAD * rng.standard_normal()
            out[3 + k] = scene.guide[knot, 3 + k] + wide * SPEED_SPREAD * rng.standard_normal()
        else:
            out[k] = rng.uniform(scene.lower[k], scene.upper[k])
            out[3 + k] = rng.uniform(-scene.limits[0], scene.limits[0])
        out[k] = min(max(out[k], scene.lower[k]), scene.upper[k])
        out[3 + k] *= scene.free[k]
    return knot, rng.random() * bound


@part
def choose(
    scene: Scene,
    tree: Tree,
    state: FloatArray,
    knot: int,
    cost: float,
    chances: Chances,
    rng: np.random.Generator,
) -> int:
    """The node to grow from: the nearest to a sample, or a promising one."""
    if rng.random() >= chances.promising:
        put_point(tree, state, knot, cost)
        return nearest(tree.places, tree.point)
    best, found = np.inf, 0
    for _ in range(FEW):
        node = rng.integers(0, tree.places.used[0])
        total = outlook(scene, tree, node)
        if total < best:
            best, found = total, node
    return found


@part
def grow_once(
    scene: Scene,
    tree: Tree,
    work: Work,
    bound: float,
    worth: float,
    chances: Chances,
    rng: np.random.Generator,
    state: FloatArray,
) -> int:
    """One iteration (lines 6 to 11): sample, choose, act; return the new node, or NONE."""
    knot, cost = sample(scene, tree, worth, chances, rng, state)
    node = choose(scene, tree, state, knot, cost, chances, rng)
    left = (scene.position.shape[0] - 1 - tree.knot[node]) // scene.edge
    if left == 0:
        return NONE
    if rng.random() < chances.action:
        control = tree.vector[4]
        for k in range(3):
            control[k] = scene.free[k] * rng.uniform(-scene.limits[1], scene.limits[1])
        new = extend(scene, tree, node, control, bound, work)
    else:
        edges = (knot - tree.knot[node]) // scene.edge
        if edges < 1:
            edges = rng.integers(1, min(left, LEG) + 1)
        new = reach(scene, tree, node, state[:3], edges, bound, work)
        if new == node:
            return NONE
    return new


@part
def trace(scene: Scene, tree: Tree, node: int, work: Work, states: FloatArray) -> None:
    """Write the states (K + 1, 6) up to a node's knot, flying each edge on its path once more."""
    while tree.parent[node] != NONE:
        parent = tree.parent[node]
        load(tree, parent, work)
        for knot in range(tree.knot[parent], tree.knot[node]):
            write_state(work, states[knot])
            step(scene, knot, tree.control[node], tree.vector[1], work)
        node = parent


@kernel
def grow(
    scene: Scene,
    tree: Tree,
    work: Work,
    bound: float,
    iterations: int,
    chances: Chances,
    rng: np.random.Generator,
    states: FloatArray,
) -> tuple[float, int, int]:
    """Grow a tree until a flight to the goal is found that costs less than a bound.

    Args:
        scene: what one robot is planned among.
        tree: storage, overwritten.
        work: working memory.
        bound: c, what the flight must cost less than, of all robots together, m/s.
        iterations: the largest number of iterations.
        chances: how often the search does what.
        rng: source of all randomness.
        states: (K + 1, 6) overwritten with the flight: position (m) and velocity (m/s).

    Returns:
        Cost of the flight, `INVALID` if none was found; iterations used; nodes in the tree.
    """
    direct = plant(scene, tree, work)
    drawn = np.zeros(6)
    if not forces_allowed(scene, 0, work):
        return INVALID, 0, 1
    for iteration in range(iterations):
        if tree.places.used[0] >= tree.cost.shape[0] - states.shape[0]:
            return INVALID, iteration, tree.places.used[0]
        new = 0
        if iteration > 0:
            worth = min(bound, 2.0 * direct + 1.0)
            new = grow_once(scene, tree, work, bound, worth, chances, rng, drawn)
        if new == NONE:
            continue
        end, left = new, (states.shape[0] - 1 - tree.knot[new]) // scene.edge
        if not at_goal(scene, tree, new):
            end = NONE
            if left > 0 and (new == 0 or rng.random() < chances.goal):
                edges = left if new == 0 or rng.random() < 0.5 else rng.integers(1, left + 1)
                end = finish(scene, tree, new, edges, bound, work)
        if end != NONE and at_goal(scene, tree, end):
            cost = settle(scene, tree, end, bound, work, states)
            if cost != INVALID:
                trace(scene, tree, end, work, states)
                return cost, iteration + 1, tree.places.used[0]
    return INVALID, iterations, tree.places.used[0]
