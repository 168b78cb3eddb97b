"""Swarms of MLR-DMPC without message loss, and the programs that arise in their flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import Neighbors
from swarm_envs.baselines.mlr_dmpc.formations import scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, sampled_positions
from swarm_envs.state import FloatArray

Situation = tuple[Trajectory, int, Neighbors, FloatArray]
"""The trajectory that a drone flies, the next round, those of others from then on, its target."""


def neighbors_of(swarm: MlrDmpcSwarm, drone: int, chosen: Sequence[int]) -> Neighbors:
    """Return the trajectories that all others may fly from the next round on."""
    known = [(i, one) for i, may in enumerate(swarm.may_fly) for one in may if i != drone]
    index = np.array([i for i, _ in known])
    paths = [sampled_positions(one, swarm.round + 1, swarm.config) for _, one in known]
    return Neighbors(np.array(paths), index, np.isin(index, chosen))


def settled(swarm: MlrDmpcSwarm) -> list[int]:
    """Drones of which it is known what they fly: those that may be planned."""
    return [i for i, may in enumerate(swarm.may_fly) if len(may) == 1]


def situation_of(swarm: MlrDmpcSwarm) -> Situation:
    """That of the first drone that may be planned; every second other one is planned with it."""
    i, count = settled(swarm)[0], len(swarm.may_fly)
    others = neighbors_of(swarm, i, [k % count for k in range(i, i + count, 2)])
    return swarm.may_fly[i][0], swarm.round + 1, others, swarm.targets[i]


def situation(
    seed: int, rounds: int, n: int, config: MlrDmpcConfig, compute_units: int = 2
) -> Situation:
    """The situation in a random swarm after so many rounds."""
    rng = np.random.default_rng(seed)
    starts, targets = scattered(n, config, rng), scattered(n, config, rng)
    swarm = MlrDmpcSwarm(
        starts, targets, config=config, compute_units=min(compute_units, n), seed=seed
    )
    while swarm.round < rounds or not settled(swarm):
        swarm.run_round()
    return situation_of(swarm)


def keep_clear(swarm: MlrDmpcSwarm, report: SwarmRound) -> None:
    """All that any drone may fly is apart, to the end of every plan; every plan was feasible."""
    config = swarm.config
    for i, may in enumerate(swarm.may_fly):
        others = neighbors_of(swarm, i, ()).positions
        for one in may:
            apart = (others - sampled_positions(one, swarm.round + 1, config)) / config.scaling
            least = np.linalg.norm(apart, axis=-1).min(initial=np.inf)
            assert least >= config.sampled_distance_m - 1e-6
    for unit in report.units:
        assert unit.planned is None or unit.planned.shifted_slack >= -1e-6


def arrival_time(
    swarm: MlrDmpcSwarm,
    limit_s: float,
    check: Callable[[MlrDmpcSwarm, SwarmRound], None] | None = None,
) -> float:
    """When all drones of a swarm are at their targets, or infinity, s; checks each round."""
    config, begin = swarm.config, swarm.round
    while (time := config.round_s * (swarm.round - begin)) < limit_s:
        away = swarm.reference(np.zeros(1))[:, 0, 0] - swarm.targets
        if (np.linalg.norm(away, axis=1) <= config.arrival_m).all():
            return time
        report = swarm.run_round()
        if check:
            check(swarm, report)
    return np.inf


def scattered(
    n: int,
    config: MlrDmpcConfig,
    rng: np.random.Generator,
    spacing: float = 0.3,
    within: FloatArray | None = None,
) -> FloatArray:
    """Places (n, 3) in the box or within corners (2, 3), no two nearer than a scaled spacing, m."""
    low, high = np.add(config.box, [[0.1], [-0.1]]) if within is None else within
    places: list[FloatArray] = []
    while len(places) < n:
        place = rng.uniform(low, high)
        if scaled_distances(np.array([*places, place]), config).min(initial=np.inf) >= spacing:
            places.append(place)
    return np.array(places)
