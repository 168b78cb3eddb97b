"""Detection of collisions for both engines, and bounces.

Drones are spheres. Two drones touch if their distance is below the sum of their radii. A drone
touches the floor, a wall or an obstacle if the distance of its center is below its radius.

Obstacles are rows of seven numbers: the kind, then for a box the lower and upper corner, for a
column x and y of the axis, the radius, and the lower and upper end. `swarm_envs.tasks.obstacles`
makes the rows.

Bounces are without friction. If two drones overlap and approach each other at speed u along the
normal n, an impulse lets them separate at `RESTITUTION` times u: for masses m1 and m2 it is
(1 + e) u / (1 / m1 + 1 / m2) n. The overlap is removed along the normal, in proportion to the
inverse masses; attitudes and rates do not change. Floor, walls and obstacles have infinite mass.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.control.loop import three
from swarm_envs.neighbors import sort_along_x
from swarm_envs.physics.rigid_body import TUMBLING_RATE
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import LANES, Field, Records, record_type

__all__ = ["BOX", "Contacts", "distances", "nearest_point"]

BOX, COLUMN = 0.0, 1.0
"""Kinds of obstacles, the first number of a row."""
ROW = 7  # Numbers in a row


def no_obstacles() -> FloatArray:
    """Return the rows (0, 7) of no obstacle."""
    return np.zeros((0, ROW))


@part
def _beyond(low: float, high: float, x: float) -> float:
    """Return the offset from x to the interval [low, high]; 0 inside."""
    return max(low - x, 0.0) + min(high - x, 0.0)


@part
def nearest_point(
    rows: FloatArray, k: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the offset from a point to the nearest point of obstacle k of (M, 7), m; 0 inside."""
    if rows[k, 0] == BOX:
        return (
            _beyond(rows[k, 1], rows[k, 4], x),
            _beyond(rows[k, 2], rows[k, 5], y),
            _beyond(rows[k, 3], rows[k, 6], z),
        )
    dx, dy = rows[k, 1] - x, rows[k, 2] - y
    away = math.sqrt(dx * dx + dy * dy)
    share = 1.0 - rows[k, 3] / away if away > rows[k, 3] else 0.0
    return share * dx, share * dy, _beyond(rows[k, 4], rows[k, 5], z)


@part
def distance_to(rows: FloatArray, k: int, x: float, y: float, z: float) -> float:
    """Return the distance from a point to obstacle k of (M, 7), m; 0 inside."""
    dx, dy, dz = nearest_point(rows, k, x, y, z)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def distances(rows: FloatArray, points: FloatArray, out: FloatArray) -> None:
    """Write the distances (P, M), m, from points (P, 3) to obstacles (M, 7)."""
    for p in range(points.shape[0]):
        for k in range(rows.shape[0]):
            out[p, k] = distance_to(rows, k, points[p, 0], points[p, 1], points[p, 2])


NO_DRONE = -1  # In `Contacts.drone`: no contact with a drone
NO_OBSTACLE = -1  # In `Contacts.obstacle`: no contact with an obstacle

ON_CONTACT = ("end_team", "end_pair", "bounce")
"""Effects of a contact: it ends the episode of the team or of the drones in contact, or drones
bounce and continue."""

NO_WALLS = np.array([[-np.inf, -np.inf, -np.inf], [np.inf, np.inf, np.inf]])
"""The arena (2, 3) without walls, m."""

PLACES = 64  # Environments whose pairs are compared side by side
SPOT_TYPE = record_type(
    tuple(
        Field(name, (PLACES,), "", None, "")
        for name in ("x", "y", "z", "radius", "distance", "ratio")
    )
)
"""The record of drone `i` in `PLACES` environments for the comparison of pairs: positions, radii,
and squares of the smallest distance to another drone, in m^2 and over the sum of radii."""


class Contacts(NamedTuple):
    """Contacts and smallest distances of drones. Arrays (E, N)."""

    drone: IntArray
    """Index of the nearest drone in contact, or -1."""
    floor: BoolArray
    """True for a contact with the floor."""
    wall: BoolArray
    """True for a contact with a wall or the ceiling of the arena."""
    tumbling: BoolArray
    """True if the drone rotates faster than 150 rad/s."""
    separation: FloatArray
    """Distance to the nearest other drone, between centers, m; infinite for a single drone."""
    clearance: FloatArray
    """Smallest distance to another drone over the sum of their radii: below 1 for a collision,
    below 1.5 for a near miss; infinite for a single drone."""
    obstacle: IntArray
    """Index of the nearest obstacle in contact, or -1."""
    obstacle_clearance: FloatArray
    """Smallest distance from the drone's center to an obstacle over its radius: below 1 for a
    collision; infinite without obstacles."""

    def any(self) -> BoolArray:
        """Return True (E, N) for drones with a contact."""
        touched = (self.drone != NO_DRONE) | (self.obstacle != NO_OBSTACLE)
        return touched | self.floor | self.wall


def contacts_of(drones: Records) -> Contacts:
    """Return the contacts of drones (E, N) in their last decision, as new arrays."""
    return Contacts(
        drone=drones["touched_drone"].astype(np.int64),
        floor=drones["touched_floor"] > 0.0,
        wall=drones["touched_wall"] > 0.0,
        tumbling=drones["tumbling"] > 0.0,
        separation=drones["separation"].copy(),
        clearance=drones["clearance"].copy(),
        obstacle=drones["touched_obstacle"].astype(np.int64),
        obstacle_clearance=drones["obstacle_clearance"].copy(),
    )


@part
def touch(blocks: Records, count: int, settings: Records) -> None:
    """Update contacts with floor and walls, and tumbling, of the drones of `count` blocks."""
    low, high = settings[0].arena[0], settings[0].arena[1]
    low_x, low_y, high_x, high_y, high_z = low[0], low[1], high[0], high[1], high[2]
    fastest = TUMBLING_RATE * TUMBLING_RATE
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            (x, y, z), r = three(b.position, lane), b.radius[lane]
            floor = 1.0 if z < r else 0.0
            left = 1.0 if x - r < low_x else 0.0
            right = 1.0 if x + r > high_x else 0.0
            front = 1.0 if y - r < low_y else 0.0
            back = 1.0 if y + r > high_y else 0.0
            above = 1.0 if z + r > high_z else 0.0
            wall = max(max(left, right), max(max(front, back), above))
            b.touched_floor[lane] = max(b.touched_floor[lane], floor)
            b.touched_wall[lane] = max(b.touched_wall[lane], wall)
            x, y, z = three(b.angular_velocity, lane)
            fast = 1.0 if x * x + y * y + z * z > fastest else 0.0
            b.tumbling[lane] = max(b.tumbling[lane], fast)


@part
def touch_obstacles(blocks: Records, slots: int, obstacles: FloatArray) -> None:
    """Update contacts with obstacles (M, 7) of the drones in the first `slots` lanes."""
    for slot in range(slots):
        b, lane = blocks[slot // LANES], slot % LANES
        for k in range(obstacles.shape[0]):
            x, y, z = three(b.position, lane)
            ratio = distance_to(obstacles, k, x, y, z) / b.radius[lane]
            if ratio < b.obstacle_clearance[lane]:
                b.obstacle_clearance[lane] = ratio
                if ratio < 1.0:
                    b.touched_obstacle[lane] = k


@part
def find_pairs(blocks: Records, count: int, drones: int, spots: Records) -> None:
    """Update separations and contacts between drones in `count` environments of few drones.

    These are at most `PLACES` environments, one after another in the blocks. Every pair of drones
    is compared in all of them side by side. `spots` (N,) is scratch of `SPOT_TYPE`.
    """
    smallest, largest = math.inf, 0.0
    for place in range(count):
        for i in range(drones):
            slot = place * drones + i
            b, lane, s = blocks[slot // LANES], slot % LANES, spots[i]
            r = b.radius[lane]
            s.x[place], s.y[place], s.z[place] = three(b.position, lane)
            s.radius[place], s.distance[place], s.ratio[place] = r, np.inf, np.inf
            smallest, largest = min(smallest, r), max(largest, r)
    for i in range(drones):
        s = spots[i]
        for j in range(i):
            t = spots[j]
            for place in range(count):
                x, y, z = t.x[place] - s.x[place], t.y[place] - s.y[place], t.z[place] - s.z[place]
                distance = x * x + y * y + z * z
                s.distance[place] = min(s.distance[place], distance)
                t.distance[place] = min(t.distance[place], distance)
            # Squares are compared, and roots are taken at the end
            if smallest < largest:  # else the nearest drone also has the smallest ratio
                for place in range(count):
                    x, y = t.x[place] - s.x[place], t.y[place] - s.y[place]
                    z, radii = t.z[place] - s.z[place], s.radius[place] + t.radius[place]
                    ratio = (x * x + y * y + z * z) / (radii * radii)
                    s.ratio[place] = min(s.ratio[place], ratio)
                    t.ratio[place] = min(t.ratio[place], ratio)
    for place in range(count):
        for i in range(drones):
            slot = place * drones + i
            b, lane, s = blocks[slot // LANES], slot % LANES, spots[i]
            radii = 2.0 * s.radius[place]
            ratio = s.ratio[place] if smallest < largest else s.distance[place] / (radii * radii)
            clearance = math.sqrt(ratio)
            if clearance < min(b.clearance[lane], 1.0):
                b.touched_drone[lane] = nearest_of(spots, drones, i, place)
            b.separation[lane] = min(b.separation[lane], math.sqrt(s.distance[place]))
            b.clearance[lane] = min(b.clearance[lane], clearance)


@part
def nearest_of(spots: Records, drones: int, i: int, place: int) -> int:
    """Return the drone with the smallest distance to drone `i` over the sum of their radii."""
    s, nearest, smallest = spots[i], NO_DRONE, math.inf
    for j in range(drones):
        t = spots[j]
        x, y, z = t.x[place] - s.x[place], t.y[place] - s.y[place], t.z[place] - s.z[place]
        ratio = math.sqrt(x * x + y * y + z * z) / (s.radius[place] + t.radius[place])
        if j != i and ratio < smallest:
            nearest, smallest = j, ratio
    return nearest


@part
def find_pairs_sorted(blocks: Records, first: int, position: FloatArray, order: IntArray) -> None:
    """Do the same as `find_pairs` for one environment of many drones, by a sweep along x.

    Its first drone is in the slot `first`; `position` (N, 3) is scratch, and `order` (N,), any
    permutation of the drones, is sorted along x.
    """
    largest, drones = 0.0, position.shape[0]
    for i in range(drones):
        b, lane = blocks[(first + i) // LANES], (first + i) % LANES
        largest = max(largest, b.radius[lane])
        for k in range(3):
            position[i, k] = b.position[k, lane]
    sort_along_x(position, order)
    for place in range(drones):
        i = order[place]
        b, lane = blocks[(first + i) // LANES], (first + i) % LANES
        radius = b.radius[lane]
        for step in (-1, 1):
            other = place + step
            while 0 <= other < drones:
                j = order[other]
                matters = max(b.separation[lane], b.clearance[lane] * (radius + largest))
                x = position[j, 0] - position[i, 0]
                if abs(x) > matters:
                    break
                y, z = position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
                distance = math.sqrt(x * x + y * y + z * z)
                if distance <= matters:
                    c, m = blocks[(first + j) // LANES], (first + j) % LANES
                    ratio = distance / (radius + c.radius[m])
                    nearer = ratio < b.clearance[lane]
                    tie = ratio == b.clearance[lane] and j < b.touched_drone[lane]
                    if ratio < 1.0 and (nearer or tie):
                        b.touched_drone[lane] = j
                    b.separation[lane] = min(b.separation[lane], distance)
                    b.clearance[lane] = min(b.clearance[lane], ratio)
                other += step


RESTITUTION = 0.5  # e: speed of separation over speed of approach


@part
def bounce(
    blocks: Records, first: int, drones: int, settings: Records, obstacles: FloatArray
) -> None:
    """Let the drones of an environment bounce at their contacts, after `find_pairs`.

    The first drone is in the slot `first`. The floor is at z = 0; obstacles are rows (M, 7).
    """
    low, high = settings[0].arena[0], settings[0].arena[1]
    for i in range(drones):
        b, lane = blocks[(first + i) // LANES], (first + i) % LANES
        if b.touched_drone[lane] != NO_DRONE:
            for j in range(drones):
                if j != i:
                    bounce_pair(blocks, first + i, first + j)
    for i in range(drones):
        b, lane = blocks[(first + i) // LANES], (first + i) % LANES
        r = b.radius[lane]
        for k in range(3):
            lowest = r if k == 2 else low[k] + r
            p, highest = b.position[k, lane], high[k] - r
            if p < lowest or p > highest:
                side = 1.0 if p < lowest else -1.0
                b.position[k, lane] = lowest if p < lowest else highest
                if side * b.velocity[k, lane] < 0.0:
                    b.velocity[k, lane] *= -RESTITUTION
        for m in range(obstacles.shape[0]):
            bounce_off(blocks, first + i, obstacles, m)


@part
def bounce_pair(blocks: Records, slot: int, other: int) -> None:
    """Let the drones of two slots bounce off each other if they overlap."""
    b, lane, c, m = blocks[slot // LANES], slot % LANES, blocks[other // LANES], other % LANES
    (x, y, z), (ox, oy, oz) = three(b.position, lane), three(c.position, m)
    x, y, z, reach = x - ox, y - oy, z - oz, b.radius[lane] + c.radius[m]
    away = math.sqrt(x * x + y * y + z * z)
    if away >= reach:
        return
    n = (x / away, y / away, z / away) if away > 0.0 else (0.0, 0.0, 1.0)
    light, heavy = 1.0 / b.mass[lane], 1.0 / c.mass[m]
    speed = 0.0
    for k in range(3):
        speed += (b.velocity[k, lane] - c.velocity[k, m]) * n[k]
    push = -(1.0 + RESTITUTION) * min(speed, 0.0) / (light + heavy)
    apart = (reach - away) / (light + heavy)
    for k in range(3):
        b.velocity[k, lane] += push * light * n[k]
        c.velocity[k, m] -= push * heavy * n[k]
        b.position[k, lane] += apart * light * n[k]
        c.position[k, m] -= apart * heavy * n[k]


@part
def bounce_off(blocks: Records, slot: int, obstacles: FloatArray, m: int) -> None:
    """Let the drone of a slot bounce off obstacle `m`; inside of it, against its velocity."""
    b, lane = blocks[slot // LANES], slot % LANES
    x, y, z = three(b.position, lane)
    x, y, z = nearest_point(obstacles, m, x, y, z)
    away = math.sqrt(x * x + y * y + z * z)
    if away >= b.radius[lane]:
        return
    depth = b.radius[lane] - away
    if away == 0.0:
        x, y, z = three(b.velocity, lane)
        away = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    n = (-x / away, -y / away, -z / away)
    speed = 0.0
    for k in range(3):
        speed += b.velocity[k, lane] * n[k]
    push = -(1.0 + RESTITUTION) * min(speed, 0.0)
    for k in range(3):
        b.velocity[k, lane] += push * n[k]
        b.position[k, lane] += depth * n[k]
