"""The search tree of AO-RRT: edges of constant control, added if valid and cheap enough.

`grow_tree` is the inner loop of stage 1 (Algorithm 1, lines 4 to 15). A node is a state with its
time and its cost. A new edge holds a random control, or steers towards a sampled position or to
rest at the goal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.propagation import (
    INVALID,
    Scene,
    WorkingState,
    evaluate_forces,
    forces_allowed,
    impulse_cost,
    propagate,
    reach_burst,
    rest_bursts,
)
from swarm_envs.compiled import kernel, part
from swarm_envs.state import FloatArray, IntArray

NONE = -1  # No node
DIMENSIONS = 8  # Dimensions of the space of nearest nodes: position, velocity, time, cost
METRIC = (1.0, 0.3, 2.0, 1.0)
"""Weights of the distance between nodes, per m, m/s, horizon, and cost of the direct flight. The
force f_a follows from position, velocity and time, so it has no weight."""
_PULL, _DAMP = 4.0, 4.0  # Critically damped; settles within two seconds
CANDIDATES = 5  # Random nodes of which the most promising is chosen
SPREAD, SPEED_SPREAD = 0.6, 0.8
"""Largest standard deviations of samples about the guide, m and m/s; most are far closer."""
LONGEST_LEG = 10  # Edges in the longest motion towards a sample that lies in the past


class Chances(NamedTuple):
    """The probabilities of the choices in an iteration of the search."""

    goal: float = 0.5  # A new node is connected straight to the goal
    action: float = 0.3  # A random action is held for one edge; else it steers to the sample
    promising: float = 0.4  # The best of a few random nodes grows; else the nearest to the sample
    guided: float = 0.7  # The sample is near the guide; else uniform
    biased: float = 0.0  # The sample is the goal, at a random time (goal biasing)


class SearchTree(NamedTuple):
    """The nodes of a search tree; the arrays are storage, written in place."""

    state: FloatArray  # (capacity, 6) position (m) and velocity (m/s)
    force: FloatArray  # (capacity, N, 3) forces on the n robots of the scene, N
    control: FloatArray  # (capacity, 3) u on the edge to the node, m/s^2
    cost: FloatArray  # (capacity,) integral of ||u|| of all robots up to the node, m/s
    knot: IntArray  # (capacity,) time in steps
    parent: IntArray  # (capacity,) the previous node; -1 for the root
    places: FloatArray  # (capacity, DIMENSIONS) the nodes in the space of `METRIC`
    used: IntArray  # (1,) number of nodes in use
    point: FloatArray  # (DIMENSIONS,) working memory
    scale: FloatArray  # (4,) metric weights by unit, set for each search
    vector: FloatArray  # (5, 3) working memory


def empty_tree(capacity: int, robots: int) -> SearchTree:
    """Return storage for trees of `capacity` nodes, for scenes with at most `robots` robots."""
    return SearchTree(
        state=np.zeros((capacity, 6)),
        force=np.zeros((capacity, robots, 3)),
        control=np.zeros((capacity, 3)),
        cost=np.zeros(capacity),
        knot=np.zeros(capacity, np.int64),
        parent=np.zeros(capacity, np.int64),
        places=np.zeros((capacity, DIMENSIONS)),
        used=np.zeros(1, np.int64),
        point=np.zeros(DIMENSIONS),
        scale=np.zeros(4),
        vector=np.zeros((5, 3)),
    )


@part
def write_point(tree: SearchTree, state: FloatArray, knot: float, cost: float) -> None:
    """Write a state (6,), time and cost into `tree.point`, scaled by the metric."""
    for k in range(3):
        tree.point[k] = tree.scale[0] * state[k]
        tree.point[3 + k] = tree.scale[1] * state[3 + k]
    tree.point[6] = tree.scale[2] * knot
    tree.point[7] = tree.scale[3] * cost


@part
def add_node(
    tree: SearchTree, parent: int, control: FloatArray, knot: int, cost: float, work: WorkingState
) -> int:
    """Add the state in the working memory as a node; return its index, or NONE without room."""
    node = tree.used[0]
    if node == tree.cost.shape[0]:
        return NONE
    tree.used[0] = node + 1
    tree.parent[node], tree.knot[node], tree.cost[node] = parent, knot, cost
    write_state(work, tree.state[node])
    for k in range(3):
        tree.control[node, k] = control[k]
    copy_forces(work.force, tree.force[node], len(work.force))
    write_point(tree, tree.state[node], knot, cost)
    for d in range(DIMENSIONS):
        tree.places[node, d] = tree.point[d]
    return node


@part
def copy_forces(source: FloatArray, target: FloatArray, robots: int) -> None:
    """Copy the first rows (n, 3) of an array into another; slices would allocate a third."""
    for j in range(robots):
        for k in range(3):
            target[j, k] = source[j, k]


@part
def load_node(tree: SearchTree, node: int, work: WorkingState) -> None:
    """Load a node's state and forces into the working memory."""
    for k in range(3):
        work.position[0, k], work.velocity[0, k] = tree.state[node, k], tree.state[node, 3 + k]
    copy_forces(tree.force[node], work.force, len(work.force))


@part
def write_state(work: WorkingState, out: FloatArray) -> None:
    """Write this robot's position and velocity into a state (6,)."""
    for k in range(3):
        out[k], out[3 + k] = work.position[0, k], work.velocity[0, k]


@part
def plant_root(scene: Scene, tree: SearchTree, work: WorkingState) -> float:
    """Start a tree at the scene's start; return all robots' cost of the direct flight, m/s."""
    direct = tree.vector[0]
    for k in range(3):
        work.position[0, k], work.velocity[0, k] = scene.start[k], 0.0
        direct[k] = scene.goal[k] - scene.start[k]
    last = scene.position.shape[0] - 1
    cost = impulse_cost(scene.table, last, direct, work.velocity[0]) + scene.cost_left[0]
    tree.scale[0], tree.scale[1] = METRIC[0], METRIC[1]
    tree.scale[2], tree.scale[3] = METRIC[2] / last, METRIC[3] / (cost + 0.1)
    tree.used[0] = 0
    evaluate_forces(scene, 0, work)
    for k in range(3):
        direct[k] = 0.0
    add_node(tree, NONE, direct, 0, 0.0, work)
    return cost


@part
def estimate_cost(scene: Scene, tree: SearchTree, node: int) -> float:
    """Return the cost of the whole flight through a node if only drag acted from there on, m/s."""
    knot, last = tree.knot[node], scene.position.shape[0] - 1
    total = tree.cost[node] + scene.cost_left[knot]
    if knot < last:
        offset = tree.vector[0]
        for k in range(3):
            offset[k] = scene.goal[k] - tree.state[node, k]
        total += impulse_cost(scene.table, last - knot, offset, tree.state[node, 3:])
    return total


@part
def extend(
    scene: Scene, tree: SearchTree, node: int, control: FloatArray, bound: float, work: WorkingState
) -> int:
    """Add an edge of constant control; return the new node, or NONE if invalid or too costly."""
    knot, cost = tree.knot[node], tree.cost[node]
    if knot + scene.edge > scene.position.shape[0] - 1:
        return NONE
    load_node(tree, node, work)
    for _ in range(scene.edge):
        spent = propagate(scene, knot, control, tree.vector[1], work)
        if spent == INVALID:
            return NONE
        cost += spent
        knot += 1
        if cost + scene.cost_left[knot] >= bound:
            return NONE
    return add_node(tree, node, control, knot, cost, work)


@part
def subtract_drift(scene: Scene, tree: SearchTree, node: int, control: FloatArray) -> bool:
    """Subtract forces other than drag from a control; return True if it is within limits."""
    for k in range(3):
        drift = tree.force[node, 0, k] / scene.mass[0] + scene.drag[k] * tree.state[node, 3 + k]
        control[k] = scene.free[k] * (control[k] - drift)
        if abs(control[k]) > scene.limits[1]:
            return False
    return True


@part
def steer_towards(
    scene: Scene,
    tree: SearchTree,
    node: int,
    place: FloatArray,
    edges: int,
    bound: float,
    work: WorkingState,
) -> int:
    """Steer from a node to a position (3,) by a number of edges; return the last node added."""
    control, offset = tree.vector[2], tree.vector[3]
    last = node
    # The burst is recomputed at each edge, as forces move the robot off the predicted path.
    for left in range(edges, 0, -1):
        for k in range(3):
            offset[k] = place[k] - tree.state[last, k]
        speed = tree.state[last, 3:]
        found = reach_burst(scene.table, scene.edge, left, scene.limits[1], offset, speed, control)
        if not (found and subtract_drift(scene, tree, last, control)):
            break
        new = extend(scene, tree, last, control, bound, work)
        if new == NONE:
            break
        last = new
    return last


@part
def steer_to_goal(
    scene: Scene, tree: SearchTree, node: int, edges: int, bound: float, work: WorkingState
) -> int:
    """Steer from a node to rest at the goal by a number of edges; return the last node, or NONE."""
    control, offset = tree.vector[2], tree.vector[3]
    last, table, limit = node, scene.table, scene.limits[1]
    for left in range(edges, 0, -1):
        speed = tree.state[last, 3:]
        for k in range(3):
            offset[k] = scene.goal[k] - tree.state[last, k]
            control[k] = -speed[k] / (scene.dt * scene.edge) + scene.drag[k] * speed[k]
        cost = (
            rest_bursts(table, scene.edge, left, limit, offset, speed, control) if left > 1 else 0.0
        )
        ahead = tree.cost[last] + cost * scene.dt + scene.cost_left[tree.knot[last]]
        # The estimate is compared with the bound once; later, only forces increase it.
        if (left == edges and ahead >= bound) or not subtract_drift(scene, tree, last, control):
            return NONE
        if cost == np.inf:
            return NONE
        last = extend(scene, tree, last, control, bound, work)
        if last == NONE:
            return NONE
    return last


@part
def at_goal(scene: Scene, tree: SearchTree, node: int) -> bool:
    """Return True if a node is within epsilon of the goal, in position and in velocity."""
    place, speed = 0.0, 0.0
    for k in range(3):
        place += (tree.state[node, k] - scene.goal[k]) ** 2
        speed += tree.state[node, 3 + k] ** 2
    return place <= scene.limits[2] ** 2 and speed <= scene.limits[3] ** 2


@part
def rest_control(scene: Scene, work: WorkingState, control: FloatArray) -> None:
    """Write the control after arrival, towards the goal by virtual tracking."""
    for k in range(3):
        error, speed = work.position[0, k] - scene.goal[k], work.velocity[0, k]
        desired = -_PULL * error - _DAMP * speed
        control[k] = scene.free[k] * (desired - work.force[0, k] / scene.mass[0])


@part
def hold_at_goal(
    scene: Scene, tree: SearchTree, node: int, bound: float, work: WorkingState, states: FloatArray
) -> float:
    """Stay at the goal from a node to the last knot, while the others fly on: PostProcess.

    Line 17 of Algorithm 1 (Sec. V-A) tracks the goal virtually after the search; here each tree
    does so. Writes `states` (K + 1, 6) from the node's knot on. Returns all robots' cost of the
    whole flight, m/s, or `INVALID` if it is invalid or reaches the bound.
    """
    control, cost = tree.vector[2], tree.cost[node]
    load_node(tree, node, work)
    for knot in range(tree.knot[node], states.shape[0]):
        write_state(work, states[knot])
        if knot == states.shape[0] - 1:
            break
        rest_control(scene, work, control)
        spent = propagate(scene, knot, control, tree.vector[1], work)
        if spent == INVALID:
            return INVALID
        cost += spent
    return cost if cost < bound else INVALID


@part
def sample_state(
    scene: Scene, bound: float, chances: Chances, rng: np.random.Generator, out: FloatArray
) -> tuple[int, float]:
    """Write a random state (6,) into `out`; return a random time and cost."""
    last = scene.position.shape[0] - 1
    knot = rng.integers(1, last + 1)
    # Cubed, so that most guided samples lie close to the guide and a few far off.
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
    if chances.biased > 0.0 and rng.random() < chances.biased:
        for k in range(3):
            out[k], out[3 + k] = scene.goal[k], 0.0
    return knot, rng.random() * bound


@part
def nearest_node(tree: SearchTree) -> int:
    """Return the node nearest to `tree.point`, by linear search, as there are few."""
    best, found = np.inf, NONE
    for node in range(tree.used[0]):
        square = 0.0
        for d in range(DIMENSIONS):
            square += (tree.places[node, d] - tree.point[d]) ** 2
        if square < best:
            best, found = square, node
    return found


@part
def select_node(
    scene: Scene,
    tree: SearchTree,
    state: FloatArray,
    knot: int,
    cost: float,
    chances: Chances,
    rng: np.random.Generator,
) -> int:
    """Return the node to grow from: the nearest to a sample, or a promising one."""
    if rng.random() >= chances.promising:
        write_point(tree, state, knot, cost)
        return nearest_node(tree)
    best, found = np.inf, 0
    for _ in range(CANDIDATES):
        node = rng.integers(0, tree.used[0])
        total = estimate_cost(scene, tree, node)
        if total < best:
            best, found = total, node
    return found


@part
def iterate_once(
    scene: Scene,
    tree: SearchTree,
    work: WorkingState,
    bound: float,
    worth: float,
    chances: Chances,
    rng: np.random.Generator,
    state: FloatArray,
) -> int:
    """Run one iteration (lines 6 to 11): sample, choose, act; return the new node, or NONE."""
    knot, cost = sample_state(scene, worth, chances, rng, state)
    node = select_node(scene, tree, state, knot, cost, chances, rng)
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
            edges = rng.integers(1, min(left, LONGEST_LEG) + 1)
        new = steer_towards(scene, tree, node, state[:3], edges, bound, work)
        if new == node:
            return NONE
    return new


@part
def write_path(
    scene: Scene, tree: SearchTree, node: int, work: WorkingState, states: FloatArray
) -> None:
    """Write the states (K + 1, 6) up to a node's knot, propagating each edge of its path again."""
    while tree.parent[node] != NONE:
        parent = tree.parent[node]
        load_node(tree, parent, work)
        for knot in range(tree.knot[parent], tree.knot[node]):
            write_state(work, states[knot])
            propagate(scene, knot, tree.control[node], tree.vector[1], work)
        node = parent


@kernel
def grow_tree(
    scene: Scene,
    tree: SearchTree,
    work: WorkingState,
    bound: float,
    iterations: int,
    chances: Chances,
    rng: np.random.Generator,
    states: FloatArray,
) -> tuple[float, int, int]:
    """Grow a tree until a flight to the goal is found that costs less than a bound.

    The bound c, m/s, is on the cost of all robots together. `tree` is overwritten; `states`
    (K + 1, 6) becomes the flight's positions (m) and velocities (m/s). Returns the cost of the
    flight, or `INVALID` if none was found, the iterations used, and the number of nodes.
    """
    direct = plant_root(scene, tree, work)
    drawn = np.zeros(6)
    if not forces_allowed(scene, 0, work):
        return INVALID, 0, 1
    for iteration in range(iterations):
        # Leaves room for the nodes of a whole path to the goal.
        if tree.used[0] >= tree.cost.shape[0] - states.shape[0]:
            return INVALID, iteration, tree.used[0]
        new = 0
        if iteration > 0:
            worth = min(bound, 2.0 * direct + 1.0)
            new = iterate_once(scene, tree, work, bound, worth, chances, rng, drawn)
        if new == NONE:
            continue
        end, left = new, (states.shape[0] - 1 - tree.knot[new]) // scene.edge
        if not at_goal(scene, tree, new):
            end = NONE
            first = new == 0 and chances.goal > 0.0
            if left > 0 and (first or rng.random() < chances.goal):
                edges = left if new == 0 or rng.random() < 0.5 else rng.integers(1, left + 1)
                end = steer_to_goal(scene, tree, new, edges, bound, work)
        if end != NONE and at_goal(scene, tree, end):
            cost = hold_at_goal(scene, tree, end, bound, work, states)
            if cost != INVALID:
                write_path(scene, tree, end, work, states)
                return cost, iteration + 1, tree.used[0]
    return INVALID, iterations, tree.used[0]
