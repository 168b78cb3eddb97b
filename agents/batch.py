"""Episodes of agents that act on arrays: many environments at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array

ActBatch = Callable[[Float32Array], Float32Array]
"""Actions (E, N, width) for observation rows (E, N, row width)."""


def fly_batch(core: SwarmCore, act: ActBatch, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Fly one episode a seed, E at a time, and return the metrics of each in order.

    Args:
        core: with the options that the agent requires.
        act: who acts; by observations alone, without memory.
        seeds: of the episodes.
    """
    metrics: list[dict[str, Any]] = []
    for first in range(0, len(seeds), core.num_envs):
        chunk = list(seeds[first : first + core.num_envs])
        idle = core.num_envs - len(chunk)
        rows = core.reset([*chunk, *[None] * idle], np.arange(core.num_envs) < len(chunk))
        while core.running.any():
            rows = core.step(act(rows)).observations
        metrics += [core.metrics(e) for e in range(len(chunk))]
    return metrics
