"""The torque head of a deep set: labels, symmetries, errors.

The target of Neural-Swarm2's eq. (8) and (10) is the vector [f_a; tau_a]. The authors learn f_a,z
alone, since they found tau_a small (Sec. VII-B). A head gives four numbers: f_a,z, and the three
components of tau_a *in the world frame*, since the network's inputs are of that frame and attitude
is none of them; in the body frame of eq. (1b) it is R^T tau_a. Labels and tables hold N m; inside,
torques are counted in gram-force centimetres, of the size of forces in gram-force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from swarm_envs.interactions.torque import GRAM_CENTIMETRE
from swarm_envs.training.force_model.network import DeepSet
from swarm_envs.training.interaction_rows.rows import FloatArray, InteractionRows


@dataclass(frozen=True)
class TorqueErrors:
    """Root mean square of the torque's error on held-out rows, N m, by component x, y, z."""

    error_n_m: tuple[float, ...]
    """Root mean squared error about each axis, N m."""
    zero_n_m: tuple[float, ...]
    """Of predicting none."""


def targets(rows: InteractionRows, torque: bool = False) -> Tensor:
    """Labels of the rows: (R,) the force in gram-force, or (R, 4) with the torque, gram-force cm.

    Raises:
        ValueError: the torque is wanted of rows that carry none.
    """
    force = torch.from_numpy(rows.force_g[:, 2]).float()
    if not torque:
        return force
    if rows.torque is None:
        raise ValueError(
            "a torque head is wanted, but the rows carry no torque; add `torque` (R, 3), N m in "
            "the world frame, to the table, or fit without --torque"
        )
    turned = torch.from_numpy(rows.torque / GRAM_CENTIMETRE).float()
    return torch.cat([force[:, None], turned], dim=1)


def predict_torque(network: DeepSet, rows: InteractionRows) -> FloatArray:
    """Torque of every row by a float64 network, (R, 3) N m, world frame."""
    from swarm_envs.training.force_model.train import to_batch

    with torch.no_grad():
        heads = network.heads(to_batch(rows, torch.float64))
    return np.asarray(heads[:, 1:].numpy() * GRAM_CENTIMETRE)


def torque_errors(network: DeepSet, rows: InteractionRows) -> TorqueErrors:
    """Errors of the torque on the rows that are held out."""
    held_out = rows.select(rows.validation)
    assert held_out.torque is not None
    error = predict_torque(network, held_out) - held_out.torque

    def rms(values: FloatArray) -> tuple[float, ...]:
        return tuple(np.sqrt(np.mean(values**2, axis=0)).tolist())

    return TorqueErrors(rms(error), rms(held_out.torque))
