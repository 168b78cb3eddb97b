"""Soft margins at the end of plans: everybody leaves room on the left, so all pass on the right."""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.state import FloatArray


def soft_weights(
    end: FloatArray, target: FloatArray, others: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """Weights (C,) of the soft margins that a drone keeps to others (Appendix B), 1/m^2.

    A large weight holds the margin open. It grows with the sine of the signed angle from (end to
    target) to (end to the other's end), counter-clockwise as seen from above, hence for others on
    the left; the paper's "to the right" is a slip.

    Args:
        end: (3,) where the present plan ends, m.
        target: (3,) m.
        others: (C, 3) where the others' trajectories end, m.
        config: weight, turn, and where soft margins hardly count.
    """
    way, aside = (target - end)[:2], (others - end)[:, :2]
    cross = way[0] * aside[:, 1] - way[1] * aside[:, 0]
    lengths = np.hypot(way[0], way[1]) * np.hypot(aside[:, 0], aside[:, 1])
    weight = config.soft_weight * np.exp(config.soft_turn * cross / np.maximum(lengths, 1e-9))
    near = np.linalg.norm(target - end) < config.soft_near_m
    return weight * (config.soft_near_factor if near else 1.0)
