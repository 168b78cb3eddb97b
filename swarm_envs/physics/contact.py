"""Collisions, by one compiled test on positions, whatever the engine.

Two drones touch when their distance is below the sum of their radii, a drone touches the floor
when its centre is lower than its radius, a wall when its sphere reaches past the arena, and an
obstacle when that is nearer to its centre than its radius.

Obstacles are rows of seven numbers: the kind, then for a box the lower and upper corner, for a
column the axis x and y, the radius, and the lower and upper end. `swarm_envs.tasks.obstacles` makes
the rows.

Where drones bounce, a drone is a sphere without friction. If two overlap, or one overlaps floor,
wall or obstacle, and they approach each other at speed u along the normal n, an impulse lets them
part at `RESTITUTION` times u: between masses m1 and m2 it is (1 + e) u / (1 / m1 + 1 / m2) n. The
overlap is removed along the normal, shared by the inverse masses; attitudes and rates stay.
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
"""Kinds of obstacles, as they stand first in a row."""
ROW = 7  # Numbers in a row


def no_obstacles() -> FloatArray:
    """Rows (0, 7) of no obstacle at all."""
    return np.zeros((0, ROW))


@part
def _beyond(low: float, high: float, x: float) -> float:
    """What must be added to x to come into [low, high]; 0 within."""
    return max(low - x, 0.0) + min(high - x, 0.0)


@part
def nearest_point(
    rows: FloatArray, k: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Offset from a point to the nearest point of obstacle k of (M, 7), m; zero inside of it."""
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
    """Distance from a point to obstacle k of the rows (M, 7), m; zero inside of it."""
    dx, dy, dz = nearest_point(rows, k, x, y, z)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def distances(rows: FloatArray, points: FloatArray, out: FloatArray) -> None:
    """Write the distance (P, M), m, from each of P points (P, 3) to each of M obstacles (M, 7)."""
    for p in range(points.shape[0]):
        for k in range(rows.shape[0]):
            out[p, k] = distance_to(rows, k, points[p, 0], points[p, 1], points[p, 2])


NO_DRONE = -1  # In `Contacts.drone`: touches no other drone
NO_OBSTACLE = -1  # In `Contacts.obstacle`: touches no obstacle

ON_CONTACT = ("end_team", "end_pair", "bounce")
"""What a contact does: it ends the episode of the whole team, it ends that of the drones that touch
something, or they bounce and fly on."""

NO_WALLS = np.array([[-np.inf, -np.inf, -np.inf], [np.inf, np.inf, np.inf]])
"""(2, 3) arena without walls, m."""

PLACES = 64  # Environments whose pairs are compared side by side
SPOT_TYPE = record_type(
    tuple(
        Field(name, (PLACES,), "", None, "")
        for name in ("x", "y", "z", "radius", "distance", "ratio")
    )
)
"""What the comparison of pairs knows of drone `i` of `PLACES` environments: where it is, and the
square of its smallest distance to another drone, in m^2 and over the square of the radii's sum."""


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


def contacts_of(drones: Records) -> Contacts:
    """The contacts of drones (E, N) in their last decision, as new arrays."""
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
    """Add what the drones of the first `count` blocks touch now of floor and walls: flags stay."""
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
    """Add which of the obstacles (M, 7) the drones in the first `slots` lanes touch now."""
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
    """Add how near the drones of `count` environments of few drones come to each other now.

    Every pair of one environment is looked at, side by side with the same pair of the others: at
    most `PLACES`, one after the other in the blocks, whose separations, clearances and drones
    touched are updated. `spots` (N,) is scratch of `SPOT_TYPE`.
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
            # Squares are compared: roots are taken once, at the end.
            if smallest < largest:  # else the nearest drone is also that of the smallest ratio
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
    """The drone of one environment that is nearest to drone `i` for the sum of their radii."""
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
    """Do as `find_pairs` in one environment of many drones: look along x only as far as needed.

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


RESTITUTION = 0.5  # Speed at which bodies part over that at which they met: e


@part
def bounce(
    blocks: Records, first: int, drones: int, settings: Records, obstacles: FloatArray
) -> None:
    """Let the drones of an environment bounce off what they overlap now; their contacts are known.

    The first is in the slot `first`. The arena's floor is the ground at z = 0; obstacles are rows
    (M, 7).
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
    """Let the drone of a slot bounce off obstacle `m`; one inside it goes back as it came."""
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
