"""Collisions, by one compiled test on positions, whatever the engine.

Two drones touch when their distance is below the sum of their radii, a drone touches the floor
when its centre is lower than its radius, a wall when its sphere reaches past the arena, and an
obstacle when that is nearer to its centre than its radius.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.neighbors import FEW, distance_between, sort_along_x
from swarm_envs.physics.obstacles import distance_to
from swarm_envs.state import BoolArray, FloatArray, IntArray

NO_DRONE = -1
"""In `Contacts.drone`: touches no other drone."""
NO_OBSTACLE = -1
"""In `Contacts.obstacle`: touches no obstacle."""

NO_WALLS = np.array([[-np.inf, -np.inf, -np.inf], [np.inf, np.inf, np.inf]])
"""(2, 3) arena without walls, m."""


class Contacts(NamedTuple):
    """Who touches what, and how close they came. Arrays (E, N)."""

    drone: IntArray
    """Index of the other drone it touches (the nearest), or -1."""
    floor: BoolArray
    """Whether it touches the floor."""
    wall: BoolArray
    """Whether it touches a wall or the ceiling of the arena."""
    tumbling: BoolArray
    """Whether it turns faster than 150 rad/s."""
    separation: FloatArray
    """Distance from its centre to that of the nearest other drone, m; infinite if alone."""
    clearance: FloatArray
    """Smallest distance to another drone as a multiple of the sum of their radii: below 1 is a
    collision, below 1.5 a near miss; infinite if alone."""
    obstacle: IntArray
    """Index of the obstacle it touches (the nearest), or -1."""
    obstacle_clearance: FloatArray
    """Smallest distance from its centre to an obstacle as a multiple of its radius: below 1 is a
    collision; infinite where there is none."""

    def any(self) -> BoolArray:
        """(E, N) whether it touches anything."""
        touched = (self.drone != NO_DRONE) | (self.obstacle != NO_OBSTACLE)
        return touched | self.floor | self.wall

    def clear(self, mask: BoolArray | slice = slice(None)) -> None:
        """Forget everything, in the environments of the mask."""
        self.drone[mask] = NO_DRONE
        self.floor[mask] = False
        self.wall[mask] = False
        self.tumbling[mask] = False
        self.separation[mask] = np.inf
        self.clearance[mask] = np.inf
        self.obstacle[mask] = NO_OBSTACLE
        self.obstacle_clearance[mask] = np.inf


def no_contacts(num_envs: int, num_drones: int) -> Contacts:
    """Contacts of swarms that touch nothing."""
    shape = (num_envs, num_drones)
    return Contacts(
        drone=np.full(shape, NO_DRONE, dtype=np.int64),
        floor=np.zeros(shape, dtype=np.bool_),
        wall=np.zeros(shape, dtype=np.bool_),
        tumbling=np.zeros(shape, dtype=np.bool_),
        separation=np.full(shape, np.inf),
        clearance=np.full(shape, np.inf),
        obstacle=np.full(shape, NO_OBSTACLE, dtype=np.int64),
        obstacle_clearance=np.full(shape, np.inf),
    )


@borrowing_kernel
def forget(e: int, contacts: Contacts) -> None:
    """Forget what environment `e` touched."""
    for i in range(contacts.drone.shape[1]):
        contacts.drone[e, i] = NO_DRONE
        contacts.floor[e, i] = contacts.wall[e, i] = contacts.tumbling[e, i] = False
        contacts.separation[e, i] = contacts.clearance[e, i] = np.inf
        contacts.obstacle[e, i], contacts.obstacle_clearance[e, i] = NO_OBSTACLE, np.inf


@borrowing_kernel
def find_contacts(
    e: int,
    position: FloatArray,
    angular_velocity: FloatArray,
    radius: FloatArray,
    arena: FloatArray,
    obstacles: FloatArray,
    order: IntArray,
    tumbling_rate: float,
    seen: Contacts,
) -> None:
    """Add what the drones of environment `e` touch now to what has been seen.

    Args:
        e: the environment.
        position: (E, N, 3) m.
        angular_velocity: (E, N, 3) rad/s.
        radius: (E, N) of the collision spheres, m.
        arena: (2, 3) lower and upper corner, m; its floor is the ground at z = 0.
        obstacles: (M, 7) rows of `swarm_envs.physics.obstacles`.
        order: (N,) any permutation of the drones; sorted along x if there are many.
        tumbling_rate: rad/s.
        seen: contacts, updated: flags stay set, distances keep their smallest value.
    """
    for i in range(position.shape[1]):
        r = radius[e, i]
        if position[e, i, 2] < r:
            seen.floor[e, i] = True
        for k in range(3):
            low = position[e, i, k] - r < arena[0, k] and k < 2
            if low or position[e, i, k] + r > arena[1, k]:
                seen.wall[e, i] = True
        x, y, z = angular_velocity[e, i, 0], angular_velocity[e, i, 1], angular_velocity[e, i, 2]
        if x * x + y * y + z * z > tumbling_rate * tumbling_rate:
            seen.tumbling[e, i] = True
        for k in range(obstacles.shape[0]):
            x, y, z = position[e, i, 0], position[e, i, 1], position[e, i, 2]
            ratio = distance_to(obstacles, k, x, y, z) / r
            if ratio < seen.obstacle_clearance[e, i]:
                seen.obstacle_clearance[e, i] = ratio
                if ratio < 1.0:
                    seen.obstacle[e, i] = k
    if position.shape[1] > FEW:
        sweep_pairs(position[e], radius[e], order, e, seen)
        return
    for i in range(position.shape[1]):
        for j in range(i):
            distance = distance_between(position[e], i, j)
            ratio = distance / (radius[e, i] + radius[e, j])
            approach(e, i, j, distance, ratio, seen)
            approach(e, j, i, distance, ratio, seen)


@borrowing_kernel
def approach(e: int, i: int, j: int, distance: float, ratio: float, seen: Contacts) -> None:
    """Note how near drone `j` is to drone `i` of environment `e`.

    Args:
        e: the environment.
        i: the drone whose contacts are updated.
        j: the other.
        distance: between their centres, m.
        ratio: that distance over the sum of their radii.
        seen: contacts, updated; of equally near drones that touch, the first is kept.
    """
    seen.separation[e, i] = min(seen.separation[e, i], distance)
    nearest = seen.clearance[e, i]
    if ratio < 1.0 and (ratio < nearest or (ratio == nearest and j < seen.drone[e, i])):
        seen.drone[e, i] = j
    seen.clearance[e, i] = min(nearest, ratio)


@borrowing_kernel
def reach_of(e: int, i: int, largest: float, seen: Contacts) -> float:
    """How near a drone must be to drone `i` to change what was seen, its contacts being updated, m.

    Args:
        e: the environment.
        i: the drone.
        largest: sum of its radius and the largest of all, m.
        seen: contacts so far.
    """
    return max(seen.separation[e, i], seen.clearance[e, i] * largest)


@borrowing_kernel
def sweep_pairs(
    position: FloatArray, radius: FloatArray, order: IntArray, e: int, seen: Contacts
) -> None:
    """Note how near all drones of environment `e` are, looking along x only as far as it matters.

    Args:
        position: (N, 3) m.
        radius: (N,) m.
        order: (N,) any permutation of the drones; sorted along x.
        e: the environment.
        seen: contacts, updated.
    """
    sort_along_x(position, order)
    largest = 0.0
    for i in range(radius.shape[0]):
        largest = max(largest, radius[i])
    for place in range(order.shape[0]):
        i = order[place]
        x, matters = position[i, 0], reach_of(e, i, radius[i] + largest, seen)
        for step in (-1, 1):
            b = place + step
            while 0 <= b < order.shape[0]:
                j = order[b]
                if abs(position[j, 0] - x) > matters:
                    break
                distance = distance_between(position, i, j)
                if distance <= matters:
                    approach(e, i, j, distance, distance / (radius[i] + radius[j]), seen)
                    matters = reach_of(e, i, radius[i] + largest, seen)
                b += step
