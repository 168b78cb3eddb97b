"""Gusts: an acceleration that all drones of an environment share, wandering at random."""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import part
from swarm_envs.noise import normal
from swarm_envs.tables import LANES, Record, Records


@part
def gust(environment: Record, first: int, drones: int, settings: Records, blocks: Records) -> None:
    """Advance the gusts of an environment by a step, and write the force on its drones.

    The acceleration is an Ornstein-Uhlenbeck process, exactly discretised.

    Args:
        environment: its record; the acceleration is changed in place.
        first: slot of its first drone in the blocks.
        drones: N.
        settings: (1,) share of the acceleration that is left after one step, and the standard
            deviation of each component, m/s^2.
        blocks: records of `LANES` drones; `external` (N, world frame) is written.
    """
    kept, strength = settings[0].gust_kept, settings[0].gust_strength
    fresh = strength * math.sqrt(1.0 - kept * kept)
    for k in range(3):
        drawn = normal(environment.gust_key, np.uint64(3 * environment.age + k))
        environment.gust[k] = kept * environment.gust[k] + fresh * drawn
        for slot in range(first, first + drones):
            b, lane = blocks[slot // LANES], slot % LANES
            b.external[k, lane] = b.mass[lane] * environment.gust[k]
