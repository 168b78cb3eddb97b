"""The training loop of a network on rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.examples import (
    Examples,
    shuffled,
    targets,
)
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.network import Batch, DeepSetSpec, ForceNetwork
from swarm_envs.training.force_model.spectral import hold_spectral_norms
from swarm_envs.training.interaction_rows import InteractionRows

HISTORY_STEPS = 500  # Number of steps between entries of the history
CHUNK = 65_536  # Number of rows that are predicted at once

Entry = dict[str, float]
"""Entry of the history: step, mean training loss since the last entry, validation MSE, g^2."""


@dataclass
class Training:
    """The state of a training."""

    network: ForceNetwork
    optimizer: torch.optim.Adam
    step: int = 0  # Number of steps so far
    history: list[Entry] = field(default_factory=list)


def train(rows: InteractionRows, spec: DeepSetSpec, config: FitConfig) -> Training:
    """Fit a network to the rows' vertical labels `force_g[:, 2]` by least squares, with Adam.

    The error of held-out rows is recorded in the history. The result has the weights of the last
    step.

    Args:
        rows: rows with prepared labels, as from `labels.prepare`.
        spec: the function to fit.
        config: the options.

    Raises:
        ValueError: training diverged.
    """
    torch.set_num_threads(1)
    run = start(spec, config)
    training, held_out = rows.select(~rows.validation), rows.select(rows.validation)
    examples, check = make_examples(training, spec, config.balance), to_batch(held_out)
    batches, losses = math.ceil(len(training) / config.batch_size), list[float]()
    bar = tqdm(range(config.steps), disable=not config.progress, unit="step")
    for step in bar:
        epoch, place = divmod(step, batches)
        if place == 0:
            order = shuffled(examples, [config.seed, epoch], turn=spec.kind == "deep-set")
        chosen = order.part(place * config.batch_size, (place + 1) * config.batch_size)
        losses.append(take_step(run, chosen, config))
        if run.step % HISTORY_STEPS == 0 or run.step == config.steps:
            error = predict(run.network, check).numpy() - held_out.force_g[:, 2]
            run.history.append(
                {
                    "step": run.step,
                    "loss": float(np.mean(losses)),
                    "validation": float(np.mean(error**2)),
                }
            )
            losses = []
            bar.set_postfix({name: f"{value:.2f}" for name, value in run.history[-1].items()})
    return run


def start(spec: DeepSetSpec, config: FitConfig) -> Training:
    """Return a new training with seeded weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = build(spec)
    hold_spectral_norms(network.parameters(), config.max_spectral_norm, config.spectral)
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)  # a batch may lack some pairs of types
    optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate, foreach=True)
    return Training(network, optimizer)


def take_step(run: Training, chosen: Examples, config: FitConfig) -> float:
    """Take one step of the optimizer on a batch; return the batch's MSE, g^2."""
    share = 0.5 * (1.0 + math.cos(math.pi * run.step / config.steps))
    run.optimizer.param_groups[0]["lr"] = config.learning_rate * share
    label = chosen.label.reshape(len(chosen.label), -1)
    squared = (run.network.heads(chosen.batch) - label) ** 2
    loss = torch.mean(chosen.weight * squared.sum(dim=1))
    run.optimizer.zero_grad(set_to_none=False)
    loss.backward()  # type: ignore[no-untyped-call]
    run.optimizer.step()
    run.step += 1
    if not all(bool(p.isfinite().all()) for p in run.network.parameters()):
        raise ValueError(
            f"training diverged: after step {run.step} weights are not finite, at loss "
            f"{float(loss.detach()):g} and learning_rate {config.learning_rate:g}; give a lower "
            "learning_rate, and look for outliers of the labels"
        )
    hold_spectral_norms(run.network.parameters(), config.max_spectral_norm, config.spectral)
    return float(squared[:, 0].detach().mean())


def make_examples(rows: InteractionRows, spec: DeepSetSpec, balance: float) -> Examples:
    """Return inputs, labels and weights of training rows."""
    label = targets(rows, spec.torque, horizontal=spec.kind == "composed")
    return Examples(to_batch(rows), label, type_weights(rows, balance))


def type_weights(rows: InteractionRows, balance: float) -> Tensor:
    """Return the weight of each row's squared error, (R,), mean 1; see `FitConfig.balance`."""
    weight = np.ones(len(rows))
    for index in range(len(rows.types)):
        own = rows.ego_type == index
        if own.any():
            weight[own] = max(float(np.mean(rows.force_g[own, 2] ** 2)), 1e-6) ** -balance
    return torch.from_numpy(weight / weight.mean()).float()


def to_batch(rows: InteractionRows, dtype: torch.dtype = torch.float32) -> Batch:
    """Convert rows to the network's inputs."""
    environment = -np.concatenate([rows.position[:, 2:], rows.velocity], axis=1)
    return Batch(
        ego_type=torch.from_numpy(rows.ego_type),
        environment=torch.from_numpy(environment).to(dtype),
        pair=torch.from_numpy(rows.neighbor).to(dtype),
        pair_type=torch.from_numpy(rows.neighbor_type),
    )


def predict(network: ForceNetwork, batch: Batch, every: bool = False) -> Tensor:
    """Return the network's vertical force (R,), gram-force, or `every` head, without gradient."""
    answer = network.heads if every else network
    with torch.no_grad():
        count = len(batch.ego_type)
        parts = [
            answer(Batch(*(values[start : start + CHUNK] for values in batch)))
            for start in range(0, count, CHUNK)
        ]
    return torch.cat(parts) if parts else torch.zeros(0)
