"""Training examples: epochs of the rows in random order, rotated and mirrored at random.

An epoch is shuffled as a whole, so that a step only takes a slice of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from swarm_envs.interactions.torque import GRAM_CENTIMETRE
from swarm_envs.training.force_model.network import Batch
from swarm_envs.training.interaction_rows.rows import InteractionRows


class Examples(NamedTuple):
    """Inputs and labels of R rows."""

    batch: Batch  # Inputs
    label: Tensor  # (R,) vertical force, gram-force; or more columns, see `targets`
    weight: Tensor  # (R,) weights of the squared errors, with mean 1

    def part(self, start: int, stop: int) -> Examples:
        """Return a slice of the rows."""
        batch = Batch(*(values[start:stop] for values in self.batch))
        return Examples(batch, self.label[start:stop], self.weight[start:stop])


def targets(rows: InteractionRows, torque: bool = False, horizontal: bool = False) -> Tensor:
    """Return labels: the force (R,), gram-force, or (R, 4) with the torque, gram-force cm.

    With `horizontal`, (R, 3): the vertical force, then x and y.
    """
    force = torch.from_numpy(rows.force_g[:, 2]).float()
    if horizontal:
        return torch.from_numpy(rows.force_g[:, [2, 0, 1]]).float()
    if not torque:
        return force
    if rows.torque is None:
        raise ValueError(
            "--torque is given, but the rows have no torque; add `torque` (R, 3), N m in "
            "the world frame, to the table, or fit without --torque"
        )
    turned = torch.from_numpy(rows.torque / GRAM_CENTIMETRE).float()
    return torch.cat([force[:, None], turned], dim=1)


def shuffled(examples: Examples, seed: Sequence[int], turn: bool) -> Examples:
    """Return the rows of an epoch in random order, with `turn` rotated and mirrored at random.

    The same seed gives the same epoch.
    """
    rng = np.random.default_rng(seed)
    count = len(examples.label)
    order = torch.from_numpy(rng.permutation(count))
    batch = Batch(*(values.index_select(0, order) for values in examples.batch))
    label, weight = (values.index_select(0, order) for values in examples[1:])
    if turn:
        turns = square_symmetries(torch.from_numpy(rng.integers(2, size=(3, count))))
        batch, label = turned_rows(batch, turns), turned_labels(label, turns)
    return Examples(batch, label, weight)


def square_symmetries(drawn: Tensor) -> Tensor:
    """Return symmetries of the square (R, 2, 2); bits (3, R) flip x, flip y, exchange x and y."""
    x, y = (1.0 - 2.0 * drawn[:2]).unbind()
    none = torch.zeros_like(x)
    plain, swapped = torch.stack([x, none, none, y], 1), torch.stack([none, y, x, none], 1)
    return torch.where(drawn[2, :, None] > 0, swapped, plain).reshape(-1, 2, 2)


def turned_rows(batch: Batch, turns: Tensor) -> Batch:
    """Return rows with horizontal positions and velocities transformed by matrices (R, 2, 2)."""
    environment, pair = batch.environment.clone(), batch.pair.clone()
    for vector, first in ((environment, 1), (pair, 0), (pair, 3)):
        x, y = vector[..., first].clone(), vector[..., first + 1].clone()
        m = turns.reshape(-1, *(1,) * (vector.ndim - 2), 2, 2)
        vector[..., first] = m[..., 0, 0] * x + m[..., 0, 1] * y
        vector[..., first + 1] = m[..., 1, 0] * x + m[..., 1, 1] * y
    return batch._replace(environment=environment, pair=pair)


def turned_labels(label: Tensor, turns: Tensor) -> Tensor:
    """Return labels (R,) of forces, or (R, 4) of forces and torques, of transformed rows.

    Vertical forces do not change. A torque transforms like a vector, with a change of sign in a
    reflection.
    """
    if label.ndim == 1:
        return label
    sign = turns[:, 0, 0] * turns[:, 1, 1] - turns[:, 0, 1] * turns[:, 1, 0]
    torque = torch.cat([(turns @ label[:, 1:3, None])[..., 0], label[:, 3:]], dim=1)
    return torch.cat([label[:, :1], sign[:, None] * torque], dim=1)
