"""Passes over the training rows: every row once, in random order, turned and shaken at random.

A pass is put in order as a whole, so that a step only takes a slice of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from swarm_envs.training.force_model.config import TrainConfig
from swarm_envs.training.force_model.network import Batch


class Examples(NamedTuple):
    """Inputs with what the network should answer."""

    batch: Batch
    label: Tensor
    """(R,) vertical force, gram-force."""
    weight: Tensor
    """(R,) of the squared error, mean 1."""

    def part(self, start: int, stop: int) -> Examples:
        """A slice of the rows."""
        batch = Batch(*(values[start:stop] for values in self.batch))
        return Examples(batch, self.label[start:stop], self.weight[start:stop])


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
    if config.symmetry == "square":
        batch = transform(batch, *_random_symmetry(count, rng))
    elif config.symmetry == "circle":
        mirror_x, mirror_y, swap = _random_symmetry(count, rng)
        angle = torch.from_numpy(rng.uniform(0.0, 2.0 * np.pi, count)).to(batch.pair.dtype)
        batch = turn(transform(batch, mirror_x, mirror_y, swap), angle)
    if config.position_jitter_m or config.velocity_jitter:
        scale = torch.tensor([config.position_jitter_m] * 3 + [config.velocity_jitter] * 3)
        noise = rng.standard_normal(batch.pair.shape, dtype=np.float32)
        batch = batch._replace(pair=batch.pair + scale * torch.from_numpy(noise))
    label, weight = (values.index_select(0, order) for values in examples[1:])
    return Examples(batch, label, weight)


def _random_symmetry(count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    signs = torch.from_numpy(rng.integers(2, size=(3, count)))
    return 1.0 - 2.0 * signs[0], 1.0 - 2.0 * signs[1], signs[2] > 0


def transform(batch: Batch, mirror_x: Tensor, mirror_y: Tensor, swap: Tensor) -> Batch:
    """Apply symmetries of the square to positions and velocities.

    Args:
        batch: R rows.
        mirror_x: (R,) +1 or -1, factor of the x components.
        mirror_y: (R,) the same for y.
        swap: (R,) whether x and y are exchanged afterwards.
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
    """Turn positions and velocities about the vertical.

    Args:
        batch: R rows.
        angle: (R,) counterclockwise seen from above, rad.
    """
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
