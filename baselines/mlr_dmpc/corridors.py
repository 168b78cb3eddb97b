"""Static obstacles as half-spaces: at each sample one between the present plan and each obstacle.

Boxes and columns are convex. The plane through the nearest point of one, across the way to it, has
all of it behind; a plan that stays `margin` before the plane stays that far off the obstacle. The
present plan, `margin` off or more at every sample, satisfies its own planes: as for other drones,
it stays feasible when it is shifted (Theorem 1 with planes in place of trajectories).

Between samples nothing is checked: at speed v a drone moves v T_c / 2 from the nearer one, so the
margin should hold that beside the drone's own radius, or T_c be finer.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.condensed import condensed
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.neighbors import HalfSpaces
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.compiled import kernel
from swarm_envs.physics.obstacles import nearest_point
from swarm_envs.state import FloatArray


def obstacle_planes(
    own: Trajectory, start_round: int, rows: FloatArray, margin_m: float, config: MlrDmpcConfig
) -> HalfSpaces:
    """Half-spaces (M, S) that keep a plan off obstacles, for `plan_trajectory`.

    Args:
        own: what the drone flies; it must be outside of every obstacle at every sample.
        start_round: round at whose beginning the plan starts.
        rows: (M, 7) obstacles, by `swarm_envs.tasks.obstacles.obstacle_rows`.
        margin_m: least distance of the drone's centre to any obstacle, m; not scaled by Theta.
        config: times.

    Raises:
        ValueError: what the drone flies enters an obstacle, so no plane is between them.
    """
    since = config.round_s * (start_round - own.identity.start_round)
    positions = own.positions(since + condensed(config).collision_times)
    offsets = _nearest(rows, positions)
    distance = np.linalg.norm(offsets, axis=-1)
    if not (distance > 0.0).all():
        obstacle, sample = np.argwhere(~(distance > 0.0))[0]
        raise ValueError(
            f"the trajectory is inside obstacle {obstacle} at {positions[sample].round(3)} m; "
            "start outside, and keep planes of all obstacles in every plan"
        )
    normals = -offsets / distance[..., None]
    along = np.einsum("rsi,rsi->rs", normals, positions + offsets)
    return HalfSpaces(normals, along + margin_m)


@kernel
def _nearest(rows: FloatArray, positions: FloatArray) -> FloatArray:
    """(M, S, 3) from positions (S, 3) to the nearest points of obstacles (M, 7), m."""
    out = np.empty((rows.shape[0], positions.shape[0], 3))
    for m in range(rows.shape[0]):
        for s in range(positions.shape[0]):
            x, y, z = positions[s]
            out[m, s, 0], out[m, s, 1], out[m, s, 2] = nearest_point(rows, m, x, y, z)
    return out
