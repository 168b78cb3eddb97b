"""Drawing episodes: placements, vehicles and streams of noise, each from its own generator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.envs.randomization import Randomization, draw_parameters
from swarm_envs.errors import check_integer
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.mission import Placement

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


def draw_placements(
    core: SwarmCore,
    task: Task,
    environments: Sequence[int],
    seeds: Sequence[int | None] | None,
    given: Mapping[str, FloatArray],
) -> dict[int, Placement]:
    """Draw placements; if one is refused, every generator goes back to where it was.

    Args:
        core: its generators are drawn from.
        task: what draws.
        environments: those that begin an episode.
        seeds: of every environment; None goes on with its generator.
        given: starts or goals (N, 3), m, that are kept.
    """
    generators, placements = list(core.generators), {}
    before = {e: generators[e].bit_generator.state for e in environments}
    try:
        for e in environments:
            seed = None if seeds is None else seeds[e]
            if seed is not None:
                generators[e] = np.random.default_rng(check_integer("seed", seed, 0))
            placements[e] = task.place(generators[e], **given)
    except Exception:
        for e, state in before.items():
            core.generators[e].bit_generator.state = state
        raise
    core.generators = generators
    return placements


def randomize(core: SwarmCore, ranges: Randomization, environments: Sequence[int]) -> None:
    """Draw vehicles, charges and streams of noise of new episodes.

    Args:
        core: its physics' parameters, force scales and keys are set, and charges at the start.
        ranges: what is drawn.
        environments: those that begin an episode.
    """
    flight, world = core.flight, core.physics.world
    nominal, battery = flight.pilot.nominal, flight.start.battery
    for e in environments:
        rng = core.generators[e]
        draw_parameters(rng, ranges, nominal, e, world.parameters)
        world.force_scale[e] = rng.uniform(*ranges.force_scale)
        battery[e] = rng.uniform(*ranges.battery, battery.shape[1])
        world.gusts.key[e], core.observer.noise_key[e] = rng.integers(2**63, size=2)
