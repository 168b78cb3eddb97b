"""Training of a deep set on rows: Adam, cosine schedule, spectral clip after every step.

A run that is killed continues from its checkpoint and ends with the same weights.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from swarm_envs.training.force_model.checkpoint import load_checkpoint, save_checkpoint
from swarm_envs.training.force_model.config import TrainConfig as TrainConfig
from swarm_envs.training.force_model.network import (
    Batch,
    DeepSet,
    DeepSetSpec,
    clip_spectral_norms,
)
from swarm_envs.training.force_model.rows import InteractionRows
from swarm_envs.training.force_model.smoothness import random_inputs, slope_penalty


@dataclass
class Training:
    """A run: what a checkpoint holds."""

    network: DeepSet
    optimiser: torch.optim.Adam
    step: int = 0
    history: list[dict[str, float]] = field(default_factory=list)
    """Step, mean training loss since the last entry, and validation MSE, g^2."""


def to_batch(rows: InteractionRows, dtype: torch.dtype = torch.float32) -> Batch:
    """Convert rows to the network's inputs."""
    environment = -np.concatenate([rows.position[:, 2:], rows.velocity], axis=1)
    return Batch(
        ego_type=torch.from_numpy(rows.ego_type),
        environment=torch.from_numpy(environment).to(dtype),
        pair=torch.from_numpy(rows.neighbor).to(dtype),
        pair_type=torch.from_numpy(rows.neighbor_type),
    )


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


def predict(network: DeepSet, batch: Batch, chunk: int = 65536) -> Tensor:
    """Vertical force from the network, (R,) in gram-force, without gradient."""
    with torch.no_grad():
        count = len(batch.ego_type)
        parts = [
            network(Batch(*(values[start : start + chunk] for values in batch)))
            for start in range(0, count, chunk)
        ]
    return torch.cat(parts) if parts else torch.zeros(0)


def start(spec: DeepSetSpec, config: TrainConfig) -> Training:
    """Make a fresh run: seeded weights, optimiser and generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = DeepSet(spec)
    if config.max_spectral_norm is not None:
        clip_spectral_norms(network, config.max_spectral_norm)
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    return Training(network, optimiser)


def train(
    rows: InteractionRows,
    spec: DeepSetSpec,
    config: TrainConfig,
    checkpoint: Path | None = None,
    progress: bool = True,
) -> Training:
    """Fit the network to the rows' vertical labels by least squares.

    The rows' validation blocks are held out; their error is recorded at every checkpoint and
    chooses nothing: the weights of the last step are the result.

    Args:
        rows: labels in `force_g[:, 2]`, already free of whatever should not be learned.
        spec: the function to fit.
        config: how.
        checkpoint: file to continue from if it exists, and to write; None keeps none.
        progress: show a progress bar.

    Raises:
        ValueError: the checkpoint belongs to another configuration.
    """
    torch.set_num_threads(1)
    run = start(spec, config)
    configuration = _configuration(rows, spec, config)
    if checkpoint is not None and checkpoint.exists():
        load_checkpoint(checkpoint, run, configuration)
    training, held_out = rows.select(~rows.validation), rows.select(rows.validation)
    batch, label = to_batch(training), _labels(training)
    weight = type_weights(training, config.balance)
    check, check_label = to_batch(held_out), _labels(held_out)
    loss_sum = 0.0
    bar = tqdm(total=config.steps, initial=run.step, disable=not progress, unit="step")
    while run.step < config.steps:
        loss_sum += _step(run, batch, label, weight, config)
        bar.update()
        if run.step % config.checkpoint_every == 0 or run.step == config.steps:
            count = run.step % config.checkpoint_every or config.checkpoint_every
            error = float(torch.mean((predict(run.network, check) - check_label) ** 2))
            entry = {"step": run.step, "loss": loss_sum / count, "validation": error}
            run.history.append(entry)
            bar.set_postfix({name: f"{value:.2f}" for name, value in entry.items()})
            loss_sum = 0.0
            if checkpoint is not None:
                save_checkpoint(checkpoint, run, configuration)
    bar.close()
    return run


def _configuration(rows: InteractionRows, spec: DeepSetSpec, config: TrainConfig) -> str:
    settings = {entry.name: getattr(config, entry.name) for entry in fields(TrainConfig)}
    labels = hashlib.sha256(rows.force_g.tobytes()).hexdigest()
    content = {"labels": labels, "spec": asdict(spec), "training": settings}
    return json.dumps(content, sort_keys=True)


def _labels(rows: InteractionRows) -> Tensor:
    return torch.from_numpy(rows.force_g[:, 2]).float()


def type_weights(rows: InteractionRows, balance: float) -> Tensor:
    """Weight of each row's squared error, (R,) with mean 1; see `TrainConfig.balance`."""
    weight = np.ones(len(rows))
    for index in range(len(rows.types)):
        own = rows.ego_type == index
        if own.any():
            weight[own] = max(float(np.mean(rows.force_g[own, 2] ** 2)), 1e-6) ** -balance
    return torch.from_numpy(weight / weight.mean()).float()


def _step(run: Training, batch: Batch, label: Tensor, weight: Tensor, config: TrainConfig) -> float:
    """Take one step of Adam on a random batch; returns the batch's MSE, g^2."""
    # A generator per step, so that a run continued from a checkpoint draws the same.
    rng = np.random.default_rng([config.seed, run.step])
    rate = 0.5 * config.learning_rate * (1 + math.cos(math.pi * run.step / config.steps))
    for group in run.optimiser.param_groups:
        group["lr"] = rate
    index = torch.from_numpy(rng.integers(len(label), size=config.batch_size))
    chosen = Batch(*(values[index] for values in batch))
    if config.symmetric:
        chosen = transform(chosen, *_random_symmetry(config.batch_size, rng))
    if config.position_jitter_m or config.velocity_jitter:
        scale = torch.tensor([config.position_jitter_m] * 3 + [config.velocity_jitter] * 3)
        noise = rng.standard_normal(chosen.pair.shape, dtype=np.float32)
        chosen = chosen._replace(pair=chosen.pair + scale * torch.from_numpy(noise))
    squared = (run.network(chosen) - label[index]) ** 2
    loss = torch.mean(weight[index] * squared)
    if config.slope_limit is not None:
        inputs = random_inputs(len(run.network.spec.types), config.slope_inputs, 2, rng)
        inputs = inputs._replace(environment=inputs.environment.float(), pair=inputs.pair.float())
        loss = loss + config.slope_weight * slope_penalty(run.network, inputs, config.slope_limit)
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    run.optimiser.step()
    if config.max_spectral_norm is not None:
        clip_spectral_norms(run.network, config.max_spectral_norm)
    run.step += 1
    return float(squared.detach().mean())


def _random_symmetry(count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    signs = torch.from_numpy(rng.integers(2, size=(3, count)))
    return 1.0 - 2.0 * signs[0], 1.0 - 2.0 * signs[1], signs[2] > 0
