"""Drones that bounce: one impulse law for both engines.

A drone is a sphere of its collision radius without friction. Where two overlap, or one overlaps
floor, wall or obstacle, and they approach each other at speed u along the normal n, an impulse lets
them part at `RESTITUTION` times u: between masses m1 and m2 it is (1 + e) u / (1 / m1 + 1 / m2) n.
The overlap is removed along the normal, shared by the inverse masses. Attitudes and body rates stay
as they are.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import part
from swarm_envs.control.loop import three
from swarm_envs.physics.contact import NO_DRONE, nearest_point
from swarm_envs.state import FloatArray
from swarm_envs.tables import LANES, Records

RESTITUTION = 0.5
"""Speed at which bodies part over that at which they met: e."""


@part
def bounce(
    blocks: Records, first: int, drones: int, settings: Records, obstacles: FloatArray | None
) -> None:
    """Let the drones of an environment bounce off what they overlap now; their contacts are known.

    The first is in the slot `first`. The arena's floor is the ground at z = 0; obstacles are rows
    (M, 7) of `swarm_envs.physics.contact`, None for none.
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
        if obstacles is not None:
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
