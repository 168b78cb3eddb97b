"""Steering, propagation and validity of one robot among moving neighbors (Alg. 1, lines 9, 10).

The integral of ||u|| (eq. 6) between two states in a given time is least with thrust at both ends
and coasting between: by the maximum principle an optimal control acts where the adjoint of v is
largest, and for linear drag that adjoint is linear in exp(drag t), so its norm is largest at an
end. Controls are held over edges of several knots, so an impulse becomes a burst of one or more
edges.

A state is [p, v, f_a] with its time, the knot. A step is valid if it stays in the box and below the
largest speed, keeps its distance throughout, and ends where no robot's force, no change of a
neighbor's force, and no neighbor's control against it exceeds its bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import predict_forces
from swarm_envs.compiled import kernel, part
from swarm_envs.interactions.forces import swarm_forces
from swarm_envs.interactions.packed import PackedField, Scratch, order_for, scratch_for
from swarm_envs.neighbors import FEW
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE

LONGEST_BURST = 8  # Edges in the longest burst that is tried
COAST, PUSH = 0, 1
"""Indices of `responses`: a velocity without control, or a control held from rest."""
PLACE, SPEED = 0, 1
"""Indices of a response: the position, m, or the speed, m/s."""


def responses(drag: FloatArray, dt: float, steps: int) -> FloatArray:
    """Return the responses (2, K + 1, 2, 3) to unit velocity and unit control over K steps of dt.

    [COAST] starts at 1 m/s without control, [PUSH] at rest with 1 m/s^2 held. Each has the [PLACE]
    (m) and [SPEED] (m/s) along each axis, with linear `drag` (3,) per mass, 1/s. The acceleration
    is held over a step.
    """
    table = np.zeros((2, steps + 1, 2, 3))
    table[COAST, 0, SPEED] = 1.0
    for mode in (COAST, PUSH):
        for k in range(steps):
            place, speed = table[mode, k]
            acceleration = mode - drag * speed
            table[mode, k + 1, PLACE] = place + dt * speed + 0.5 * dt * dt * acceleration
            table[mode, k + 1, SPEED] = speed + dt * acceleration
    return table


@kernel
def impulse_cost(table: FloatArray, steps: int, offset: FloatArray, velocity: FloatArray) -> float:
    """Return the least integral of ||u||, m/s, from a velocity (3,) to rest at an offset (3,), m.

    It belongs to two impulses and is a lower bound if only drag acts; exactly so in the limit of
    short steps, as drag is held within a step. `table` is from `responses`.
    """
    first, last = 0.0, 0.0
    for k in range(3):
        needed = offset[k] / table[COAST, steps, PLACE, k]
        first += (needed - velocity[k]) ** 2
        last += (needed * table[COAST, steps, SPEED, k]) ** 2
    return math.sqrt(first) + math.sqrt(last)


@kernel
def reach_burst(
    table: FloatArray,
    edge: int,
    edges: int,
    limit: float,
    offset: FloatArray,
    velocity: FloatArray,
    control: FloatArray,
) -> bool:
    """Find the shortest burst after which coasting leads to a position in time, at any velocity.

    The position is an `offset` (3,), m, and a number of `edges`, of `edge` steps each, ahead;
    `limit` is the largest |u| along an axis, m/s^2. Writes the burst's `control` (3,), m/s^2.
    Returns True if there is one; else the control is the longest burst's, beyond the limit.
    """
    total = edges * edge
    for burst in range(1, min(edges, LONGEST_BURST) + 1):
        on, off, largest = burst * edge, total - burst * edge, 0.0
        for k in range(3):
            gain = table[PUSH, on, PLACE, k]
            gain += table[PUSH, on, SPEED, k] * table[COAST, off, PLACE, k]
            control[k] = (offset[k] - table[COAST, total, PLACE, k] * velocity[k]) / gain
            largest = max(largest, abs(control[k]))
        if largest <= limit:
            return True
    return False


@kernel
def rest_bursts(
    table: FloatArray,
    edge: int,
    edges: int,
    limit: float,
    offset: FloatArray,
    velocity: FloatArray,
    control: FloatArray,
) -> float:
    """Find the cheapest bursts, at the start and the end, that lead to rest at a position in time.

    The arguments are those of `reach_burst`, with at least 2 edges; writes the first burst's
    `control`. Returns the integral of ||u|| over both, in steps times m/s^2; infinite if there are
    none.
    """
    best, total = np.inf, edges * edge
    longest = min(edges - 1, LONGEST_BURST)
    for first in range(1, longest + 1):
        for last in range(1, min(edges - first, longest) + 1):
            on, end = first * edge, last * edge
            largest, norm_first, norm_last = 0.0, 0.0, 0.0
            x = y = z = 0.0
            for k in range(3):
                pushed = table[PUSH, on, SPEED, k]
                a = table[PUSH, on, PLACE, k] + pushed * table[COAST, total - on, PLACE, k]
                b = table[PUSH, end, PLACE, k]
                c = pushed * table[COAST, total - on, SPEED, k]
                d = table[PUSH, end, SPEED, k]
                place = offset[k] - table[COAST, total, PLACE, k] * velocity[k]
                speed = -table[COAST, total, SPEED, k] * velocity[k]
                determinant = a * d - b * c
                now = (place * d - b * speed) / determinant
                then = (a * speed - c * place) / determinant
                largest = max(largest, abs(now), abs(then))
                norm_first += now * now
                norm_last += then * then
                if k == 0:
                    x = now
                elif k == 1:
                    y = now
                else:
                    z = now
            cost = on * math.sqrt(norm_first) + end * math.sqrt(norm_last)
            if largest <= limit and cost < best:
                best = cost
                control[0], control[1], control[2] = x, y, z
    return best


INVALID = -1.0  # The cost of an invalid step
_SLACK = 1e-9  # Tolerance for rounding


class Scene(NamedTuple):
    """One robot's planning problem for compiled kernels; robot 0 of n is the one planned.

    K is the largest number of steps. Robots that have no motion yet are not among the n.
    """

    field: PackedField  # The planner's force model
    types: IntArray  # (n,) interaction types
    mass: FloatArray  # (n,) kg
    clearance: FloatArray  # (n,) distance to keep from each robot, m
    force_limit: FloatArray  # (n,) f_a,max, the largest |f_a,z|, N
    force_change: float  # b_fa, N
    position: FloatArray  # (K + 1, n, 3) the others' motions, m; row 0 of each knot is free
    velocity: FloatArray  # (K + 1, n, 3) m/s
    acceleration: FloatArray  # (K + 1, n, 3) held after each knot, m/s^2
    force_before: FloatArray  # (K + 1, n) vertical forces before this robot is replanned, N
    cost_left: FloatArray
    """(K + 1,) cost of the others' controls from each knot on without this robot, m/s."""
    start: FloatArray  # (3,) m
    goal: FloatArray  # (3,) m
    guide: FloatArray
    """(K + 1, 6) a motion near which to sample: the previous one, or the straight line."""
    lower: FloatArray  # (3,) m; along an axis that is not free, the start
    upper: FloatArray  # (3,) m
    free: FloatArray  # (3,) 1 along axes in which the robot may move, else 0
    limits: FloatArray
    """(4,) largest speed (m/s) and |u| (m/s^2); distance (m) and speed (m/s) at the goal."""
    drag: FloatArray  # (3,) the robot's own drag per mass, 1/s
    table: FloatArray  # `responses` of the robot
    dt: float  # Length of a step, s
    edge: int  # Steps in an edge


class WorkingState(NamedTuple):
    """Working memory: the state of all n robots at one knot."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    force: FloatArray  # (n, 3) N
    order: IntArray | None  # That of `find_pairs`
    scratch: Scratch  # Working memory of the force model, with the robots' types


def working_state(scene: Scene) -> WorkingState:
    """Return working memory for a scene."""
    n = len(scene.types)
    position, velocity, force = np.zeros((3, n, 3))
    scratch = scratch_for(scene.field, 1, n)
    scratch.drones["type"] = scene.types
    order = order_for(1, n) if n > FEW else None
    return WorkingState(position, velocity, force, order, scratch)


def make_scene(
    problem: PlanningProblem, robot: int, states: FloatArray, planned: list[int], edge: int
) -> Scene:
    """Return the scene for planning one robot among the `planned` ones, which have motions.

    Rows of `states` (K + 1, N, 6) for other robots are not read. `edge` is the length of an edge of
    the search tree in steps.
    """
    others = [j for j in planned if j != robot]
    index, bounds = [robot, *others], problem.bounds
    team = tuple(problem.team[j] for j in index)
    knots, start, goal = len(states), problem.starts[robot], problem.goals[robot]
    alone, before = np.zeros((knots, len(others), 3)), np.zeros((knots, len(index)))
    guide = states[:, robot].copy()
    if robot not in planned:  # The straight line at constant speed
        share = np.linspace(0.0, 1.0, knots)[:, None]
        speed = np.broadcast_to((goal - start) / (problem.dt * max(knots - 1, 1)), (knots, 3))
        guide = np.concatenate((start + share * (goal - start), speed), axis=1)
    if others:
        alone = predict_forces(problem.model, team[1:], states[:, others])
        before[:, 1:] = alone[..., 2]
        if robot in planned:
            before[:] = predict_forces(problem.model, team, states[:, index])[..., 2]
    acceleration = np.zeros((knots, len(index), 3))
    acceleration[:-1, 1:] = np.diff(states[:, others, 3:], axis=0) / problem.dt
    mass, free = problem.masses[index], np.zeros(3)
    controls = (acceleration[:, 1:] - alone / mass[1:, None])[:-1]
    spent = np.linalg.norm(controls, axis=2).sum(axis=1) * problem.dt
    free[list(problem.axes)] = 1.0
    types = problem.model.type_indices(team)
    drag = problem.model.field.drag[types[0]] / mass[0]
    return Scene(
        field=problem.model.packed,
        types=types,
        mass=mass,
        clearance=bounds.clearances(problem.team)[robot, index],
        force_limit=bounds.force_bounds(team),
        force_change=bounds.force_change_g * GRAM_FORCE,
        position=np.ascontiguousarray(states[:, index, :3]),
        velocity=np.ascontiguousarray(states[:, index, 3:]),
        acceleration=acceleration,
        force_before=before,
        cost_left=np.append(np.cumsum(spent[::-1])[::-1], 0.0),
        start=start.copy(),
        goal=goal.copy(),
        guide=guide,
        lower=np.where(free > 0.0, bounds.lower, start - 1e-6),
        upper=np.where(free > 0.0, bounds.upper, start + 1e-6),
        free=free,
        limits=np.array(
            [bounds.speed, bounds.acceleration, bounds.goal_distance, bounds.goal_speed]
        ),
        drag=drag,
        table=responses(drag, problem.dt, knots - 1),
        dt=problem.dt,
        edge=edge,
    )


# ---- Compiled: propagation of one step, and its validity


@part
def evaluate_forces(scene: Scene, knot: int, work: WorkingState) -> None:
    """Load the others' states at a knot, and evaluate the forces on all robots."""
    drones, robots = work.scratch.drones, work.position.shape[0]
    for j in range(robots):
        for k in range(3):
            if j > 0:
                work.position[j, k] = scene.position[knot, j, k]
                work.velocity[j, k] = scene.velocity[knot, j, k]
            drones[j]["position"][k] = work.position[j, k]
            drones[j]["velocity"][k] = work.velocity[j, k]
    swarm_forces(scene.field, 1, robots, work.order, work.scratch)
    for j in range(robots):
        for k in range(3):
            work.force[j, k] = drones[j]["force"][k]


@part
def forces_allowed(scene: Scene, knot: int, work: WorkingState) -> bool:
    """Return True if all forces at a knot, and the others' controls against them, are in bounds."""
    for j in range(work.force.shape[0]):
        force = work.force[j, 2]
        if abs(force) > scene.force_limit[j]:
            return False
        if j == 0:
            continue
        if abs(force - scene.force_before[knot, j]) > scene.force_change:
            return False
        for k in range(3):
            control = scene.acceleration[knot, j, k] - work.force[j, k] / scene.mass[j]
            if abs(control) > scene.limits[1] + _SLACK:
                return False
    return True


@part
def control_cost(scene: Scene, knot: int, control: FloatArray, work: WorkingState) -> float:
    """Return the sum over robots of ||u|| at a knot, the others' controls being against forces."""
    total = math.sqrt(control[0] ** 2 + control[1] ** 2 + control[2] ** 2)
    for j in range(1, work.force.shape[0]):
        square = 0.0
        for k in range(3):
            u = scene.acceleration[knot, j, k] - work.force[j, k] / scene.mass[j]
            square += u * u
        total += math.sqrt(square)
    return total


@part
def squared_gap(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Return the squared distance of the origin from the segment between two points."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = x * x + y * y + z * z
    along = -(a[0] * x + a[1] * y + a[2] * z)
    share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    return (a[0] + share * x) ** 2 + (a[1] + share * y) ** 2 + (a[2] + share * z) ** 2


@part
def relative_position(
    scene: Scene, knot: int, j: int, work: WorkingState, acceleration: FloatArray, t: float
) -> tuple[float, float, float]:
    """Return the position of robot j relative to this one, a time t after a knot, m."""
    place, speed, change = scene.position[knot, j], scene.velocity[knot, j], work.velocity[0]
    held, here = scene.acceleration[knot, j], work.position[0]
    x = place[0] - here[0] + t * (speed[0] - change[0] + 0.5 * t * (held[0] - acceleration[0]))
    y = place[1] - here[1] + t * (speed[1] - change[1] + 0.5 * t * (held[1] - acceleration[1]))
    z = place[2] - here[2] + t * (speed[2] - change[2] + 0.5 * t * (held[2] - acceleration[2]))
    return x, y, z


@part
def keeps_clearance(scene: Scene, knot: int, work: WorkingState, acceleration: FloatArray) -> bool:
    """Return True if the step after a knot keeps its distance from all others, also between knots.

    The relative path, a parabola, is approximated by two chords, with an error of |a| dt^2 / 32:
    3 mm at 10 m/s^2 and 0.1 s.
    """
    for j in range(1, work.position.shape[0]):
        a = relative_position(scene, knot, j, work, acceleration, 0.0)
        b = relative_position(scene, knot, j, work, acceleration, 0.5 * scene.dt)
        c = relative_position(scene, knot, j, work, acceleration, scene.dt)
        if min(squared_gap(a, b), squared_gap(b, c)) < scene.clearance[j] ** 2:
            return False
    return True


@part
def propagate(
    scene: Scene, knot: int, control: FloatArray, acceleration: FloatArray, work: WorkingState
) -> float:
    """Propagate a step from a knot under a held control u (3,), m/s^2.

    This robot's state and all forces at the knot, in `work`, are overwritten by those at the next;
    `acceleration` (3,) is working memory. Returns the cost of all robots' controls in the step, the
    integral of ||u||, m/s, or `INVALID` if the step is invalid.
    """
    dt, speed, limit = scene.dt, scene.limits[0], scene.limits[1]
    cost = control_cost(scene, knot, control, work) * dt
    for k in range(3):
        if abs(control[k]) > limit + _SLACK:
            return INVALID
        acceleration[k] = scene.free[k] * (control[k] + work.force[0, k] / scene.mass[0])
    if not keeps_clearance(scene, knot, work, acceleration):
        return INVALID
    for k in range(3):
        here, v = work.position[0, k], work.velocity[0, k]
        there = here + dt * (v + 0.5 * dt * acceleration[k])
        work.position[0, k] = there
        work.velocity[0, k] = v + dt * acceleration[k]
        outside = there < scene.lower[k] or there > scene.upper[k]
        if outside or abs(work.velocity[0, k]) > speed + _SLACK:
            return INVALID
    evaluate_forces(scene, knot + 1, work)
    if not forces_allowed(scene, knot + 1, work):
        return INVALID
    return cost
