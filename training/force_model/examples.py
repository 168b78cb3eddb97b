"""Training examples: epochs of the rows in random order, and rows that are held out of them.

In a pass every row comes once, turned and mirrored at random. A pass is put in order as a whole,
so that a step only takes a slice of it.

Early validation holds out training rows to choose weights or settings, never the validation rows.
There are two kinds, since a model may generalise in time and still know its flights: contiguous
pieces of flights that are trained on, and whole flights.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from swarm_envs.interactions.torque import GRAM_CENTIMETRE
from swarm_envs.training.force_model.force_fit_config import TrainConfig
from swarm_envs.training.force_model.network import Batch
from swarm_envs.training.interaction_rows.rows import InteractionRows

Change = Callable[[Batch], Batch]
"""Turns and mirrors rows."""


class Examples(NamedTuple):
    """Inputs with what the network should answer."""

    batch: Batch
    """Inputs and labels of all rows."""
    label: Tensor
    """(R,) vertical force, gram-force; or more columns, as `targets`."""
    weight: Tensor
    """(R,) of the squared error, mean 1."""

    def part(self, start: int, stop: int) -> Examples:
        """A slice of the rows."""
        batch = Batch(*(values[start:stop] for values in self.batch))
        return Examples(batch, self.label[start:stop], self.weight[start:stop])


def targets(rows: InteractionRows, torque: bool = False, horizontal: bool = False) -> Tensor:
    """Labels of the rows: (R,) the force in gram-force, or (R, 4) with the torque, gram-force cm.

    With the horizontal force (R, 3): the vertical first, then x and y.
    """
    force = torch.from_numpy(rows.force_g[:, 2]).float()
    if horizontal:
        return torch.from_numpy(rows.force_g[:, [2, 0, 1]]).float()
    if not torque:
        return force
    if rows.torque is None:
        raise ValueError(
            "a torque head is wanted, but the rows carry no torque; add `torque` (R, 3), N m in "
            "the world frame, to the table, or fit without --torque"
        )
    turned = torch.from_numpy(rows.torque / GRAM_CENTIMETRE).float()
    return torch.cat([force[:, None], turned], dim=1)


def batches_per_epoch(rows: int, batch_size: int) -> int:
    """Steps that one pass takes; the last batch may be smaller."""
    return -(-rows // batch_size)


def shuffled(examples: Examples, config: TrainConfig, epoch: int) -> Examples:
    """The rows of pass number `epoch`, in its order and with its random changes.

    The same seed and number give the same pass, so that a run continues within one.
    """
    rng = np.random.default_rng([config.seed, epoch])
    count = len(examples.label)
    order = torch.from_numpy(rng.permutation(count))
    batch = Batch(*(values.index_select(0, order) for values in examples.batch))
    label, weight = (values.index_select(0, order) for values in examples[1:])
    if config.symmetry != "none":
        change = _random_change(config.symmetry == "circle", count, rng)
        batch, label = change(batch), changed_label(label, change)
    if config.position_jitter_m or config.velocity_jitter:
        scale = torch.tensor([config.position_jitter_m] * 3 + [config.velocity_jitter] * 3)
        noise = rng.standard_normal(batch.pair.shape, dtype=np.float32)
        batch = batch._replace(pair=batch.pair + scale * torch.from_numpy(noise))
    return Examples(batch, label, weight)


def _random_change(circle: bool, count: int, rng: np.random.Generator) -> Change:
    """A symmetry of its own for each of `count` rows: of the square, or any turn too."""
    mirror_x, mirror_y, swap = _random_symmetry(count, rng)
    angle = torch.from_numpy(rng.uniform(0.0, 2.0 * np.pi, count)) if circle else None

    def change(batch: Batch) -> Batch:
        changed = transform(batch, mirror_x, mirror_y, swap)
        return changed if angle is None else turn(changed, angle.to(batch.pair.dtype))

    return change


def changed_label(label: Tensor, change: Change) -> Tensor:
    """Labels (R,) of forces, or (R, 4) of forces and torques, of rows that were turned or mirrored.

    Forces along z stay. A torque turns like a vector, and with a mirror changes its sign besides.
    """
    if label.ndim == 1:
        return label
    units = torch.tensor([1.0, 0.0, 0.0, 0.0, 1.0, 0.0], dtype=label.dtype)
    nobody = torch.zeros(len(label), 1, dtype=torch.long)
    moved = change(Batch(nobody[:, 0], label.clone(), units.expand(len(label), 1, 6), nobody))
    x, y = moved.pair[:, 0, :3], moved.pair[:, 0, 3:]
    sign = x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]
    return torch.cat([label[:, :1], sign[:, None] * moved.environment[:, 1:]], dim=1)


def _random_symmetry(count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    signs = torch.from_numpy(rng.integers(2, size=(3, count)))
    return 1.0 - 2.0 * signs[0], 1.0 - 2.0 * signs[1], signs[2] > 0


def transform(batch: Batch, mirror_x: Tensor, mirror_y: Tensor, swap: Tensor) -> Batch:
    """Apply symmetries of the square to positions and velocities of R rows.

    `mirror_x` and `mirror_y` (R,) are +1 or -1; x and y are exchanged afterwards where `swap`.
    """
    one = torch.ones_like(mirror_x)
    factor = torch.stack([mirror_x, mirror_y, one], dim=1)
    environment = batch.environment * torch.cat([one[:, None], factor], dim=1)
    pair = batch.pair * factor.repeat(1, 2)[:, None]
    swapped = environment[:, [0, 2, 1, 3]]
    environment = torch.where(swap[:, None], swapped, environment)
    pair = torch.where(swap[:, None, None], pair[..., [1, 0, 2, 4, 3, 5]], pair)
    return batch._replace(environment=environment, pair=pair)


def turn(batch: Batch, angle: Tensor) -> Batch:
    """Turn positions and velocities by angles (R,), rad, counterclockwise seen from above."""
    cosine, sine = torch.cos(angle), torch.sin(angle)

    def turned(vector: Tensor, first: int) -> None:
        shape = (-1,) + (1,) * (vector.ndim - 2)
        c, s = cosine.reshape(shape), sine.reshape(shape)
        x, y = vector[..., first].clone(), vector[..., first + 1].clone()
        vector[..., first] = c * x - s * y
        vector[..., first + 1] = s * x + c * y

    environment, pair = batch.environment.clone(), batch.pair.clone()
    turned(environment, 1)
    turned(pair, 0)
    turned(pair, 3)
    return batch._replace(environment=environment, pair=pair)
