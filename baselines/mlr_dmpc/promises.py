"""Planning next to a plan that was sent but not heard: by what it is known to have kept.

Drone j's plan q of round r, by unit v, has kept n . Theta^-1 (q - p) >= d against the trajectory p
that drone i flew, with n the normal of the plane (15) between p and j's old trajectory c, if v knew
p. If i still flies p, a new plan p' of i with n . Theta^-1 (p' - p) <= 0 keeps
n . Theta^-1 (q - p') >= d, whatever q is. Half-spaces of this kind leave no slack to what is flown:
half of `SPARE_M` goes into the rounding of its state.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.knowledge import Knowledge
from swarm_envs.baselines.mlr_dmpc.neighbors import (
    SPARE_M,
    HalfSpaces,
    Neighbors,
    voronoi_planes,
)
from swarm_envs.baselines.mlr_dmpc.samples import sampled
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory


def promised_planes(
    know: Knowledge,
    drone: int,
    own: Trajectory,
    other: int,
    round_: int,
    config: MlrDmpcConfig,
) -> HalfSpaces | None:
    """Half-spaces for a drone that keep it clear of another's unknown plans, if there are any.

    Args:
        know: what the unit knows.
        drone: i, which is to be planned.
        own: what it flies.
        other: j.
        round_: k.
        config: parameters.
    """
    if know.void(drone, round_) or know.void(other, round_):
        return None
    tracker = know.trackers[other]
    parents: list[Trajectory] = []
    for identity in tracker.missing:
        promise = tracker.promise(identity)
        start = own.identity.start_round
        if promise is None or start > promise.round:
            return None
        author = identity.compute_unit
        knows = own.identity.compute_unit == author
        if not (knows or know.knew(author, drone, start, promise.round)):
            return None
        parents += promise.parents
    positions = sampled(own, round_ + 1, config)
    others = np.stack([sampled(parent, round_ + 1, config) for parent in parents])
    nobody = np.zeros(len(others), dtype=np.int64)
    beside = Neighbors(others, nobody, np.zeros(len(others), dtype=bool))
    normals = voronoi_planes(positions, beside, config).normals
    flown = np.einsum("psi,si->ps", normals, positions)
    return HalfSpaces(normals, flown - SPARE_M / 2)
