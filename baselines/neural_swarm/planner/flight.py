"""One step of one robot among moving neighbours: propagation and validity (Algorithm 1, 9 and 10).

A state is [p, v, f_a] with its time, the knot. Valid is a step that stays in the box and below the
largest speed, keeps its distance all along, and ends where no robot's force, no change of a
neighbour's force, and no neighbour's control against it exceeds its bound.
"""

from __future__ import annotations

import math

from swarm_envs.baselines.neural_swarm.planner.scene import Scene, Work
from swarm_envs.compiled import kernel
from swarm_envs.interactions.forces import swarm_forces
from swarm_envs.state import FloatArray

INVALID = -1.0
"""What a step costs that must not be flown."""
_SLACK = 1e-9  # rounding


@kernel
def feel(scene: Scene, knot: int, work: Work) -> None:
    """Put the others where they are at a knot, and evaluate the forces on all robots."""
    drones, robots = work.scratch.drones, work.position.shape[0]
    for j in range(robots):
        for k in range(3):
            if j > 0:
                work.position[j, k] = scene.position[knot, j, k]
                work.velocity[j, k] = scene.velocity[knot, j, k]
            drones[j]["position"][k] = work.position[j, k]
            drones[j]["velocity"][k] = work.velocity[j, k]
    swarm_forces(scene.field, 1, robots, work.scratch)
    for j in range(robots):
        for k in range(3):
            work.force[j, k] = drones[j]["force"][k]


@kernel
def forces_allowed(scene: Scene, knot: int, work: Work) -> bool:
    """Whether all forces at a knot, and the others' controls against them, are within bounds."""
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


@kernel
def control_cost(scene: Scene, knot: int, control: FloatArray, work: Work) -> float:
    """Sum over all robots of ||u|| at a knot: this robot's control, the others' against forces."""
    total = math.sqrt(control[0] ** 2 + control[1] ** 2 + control[2] ** 2)
    for j in range(1, work.force.shape[0]):
        square = 0.0
        for k in range(3):
            u = scene.acceleration[knot, j, k] - work.force[j, k] / scene.mass[j]
            square += u * u
        total += math.sqrt(square)
    return total


@kernel
def closest(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Squared distance of the origin from the segment between two points."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = x * x + y * y + z * z
    along = -(a[0] * x + a[1] * y + a[2] * z)
    share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    return (a[0] + share * x) ** 2 + (a[1] + share * y) ** 2 + (a[2] + share * z) ** 2


@kernel
def offset(
    scene: Scene, knot: int, j: int, work: Work, acceleration: FloatArray, t: float
) -> tuple[float, float, float]:
    """Where robot j is, seen from this one, a time t after a knot, m."""
    place, speed, change = scene.position[knot, j], scene.velocity[knot, j], work.velocity[0]
    held, here = scene.acceleration[knot, j], work.position[0]
    x = place[0] - here[0] + t * (speed[0] - change[0] + 0.5 * t * (held[0] - acceleration[0]))
    y = place[1] - here[1] + t * (speed[1] - change[1] + 0.5 * t * (held[1] - acceleration[1]))
    z = place[2] - here[2] + t * (speed[2] - change[2] + 0.5 * t * (held[2] - acceleration[2]))
    return x, y, z


@kernel
def keeps_clear(scene: Scene, knot: int, work: Work, acceleration: FloatArray) -> bool:
    """Whether the step after a knot keeps its distance from all others, also between knots.

    The relative path, a parabola, is taken as two chords: off by |a| dt^2 / 32, 3 mm at 10 m/s^2
    and 0.1 s.
    """
    for j in range(1, work.position.shape[0]):
        a = offset(scene, knot, j, work, acceleration, 0.0)
        b = offset(scene, knot, j, work, acceleration, 0.5 * scene.dt)
        c = offset(scene, knot, j, work, acceleration, scene.dt)
        if min(closest(a, b), closest(b, c)) < scene.clearance[j] ** 2:
            return False
    return True


@kernel
def step(
    scene: Scene, knot: int, control: FloatArray, acceleration: FloatArray, work: Work
) -> float:
    """Fly one step from a knot.

    Args:
        scene: what is around.
        knot: the knot at which it begins.
        control: (3,) u, held, m/s^2.
        acceleration: (3,) working memory.
        work: this robot's state and all forces at the knot; overwritten by those at the next.

    Returns:
        What all robots' controls cost in the step, the integral of ||u||, m/s; `INVALID` if the
        step must not be flown.
    """
    dt, speed, limit = scene.dt, scene.limits[0], scene.limits[1]
    cost = control_cost(scene, knot, control, work) * dt
    for k in range(3):
        if abs(control[k]) > limit + _SLACK:
            return INVALID
        acceleration[k] = scene.free[k] * (control[k] + work.force[0, k] / scene.mass[0])
    if not keeps_clear(scene, knot, work, acceleration):
        return INVALID
    for k in range(3):
        here, v = work.position[0, k], work.velocity[0, k]
        there = here + dt * (v + 0.5 * dt * acceleration[k])
        work.position[0, k] = there
        work.velocity[0, k] = v + dt * acceleration[k]
        outside = there < scene.lower[k] or there > scene.upper[k]
        if outside or abs(work.velocity[0, k]) > speed + _SLACK:
            return INVALID
    feel(scene, knot + 1, work)
    if not forces_allowed(scene, knot + 1, work):
        return INVALID
    return cost
