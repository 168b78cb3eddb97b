"""Training of a network on rows, and of the teachers that it may learn from.

A run that is killed continues from its checkpoint and ends with the same weights. A checkpoint is
a safetensors file of weights, optimiser, averages and history.

With teachers a network learns the mean of others, trained before it on the same rows. Labels are
noisy, and a network of this size has learned some of the noise before it has learned the force.
The mean of a few such networks has less of both kinds of error than each of them, and the mean
over the symmetries of the square less again. One network of the same size can learn it (Hinton et
al. 2015, arXiv:1503.02531). Held-out rows teach no network.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor
from tqdm import tqdm

from swarm_envs.state import FloatArray
from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.examples import (
    Examples,
    batches_per_epoch,
    shuffled,
    square_symmetry,
    targets,
    turned_rows,
)
from swarm_envs.training.force_model.export import write_safetensors
from swarm_envs.training.force_model.force_fit_config import TrainConfig as TrainConfig
from swarm_envs.training.force_model.force_fit_config import with_mode_defaults
from swarm_envs.training.force_model.lipschitz import random_inputs, slope_penalty
from swarm_envs.training.force_model.network import Batch, DeepSetSpec, ForceNetwork
from swarm_envs.training.force_model.optimisers import FlatWeights, Soap, hold_spectral_norms
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.rows import ROW_ARRAYS
from swarm_envs.training.provenance import check_same

_OPTIMISER = "optimiser."


def save_checkpoint(path: Path, run: Training, configuration: str) -> None:
    """Write everything that `load_checkpoint` needs; only the same `configuration` may continue."""
    weights = run.weights
    tensors = {"weights": weights.values.detach()}
    tensors |= {"averaged": run.averaged}
    tensors |= {_OPTIMISER + k: v for k, v in run.optimiser.state[weights.values].items()}
    metadata = {
        "step": str(run.step),
        "history": json.dumps(run.history),
        "configuration": configuration,
    }
    write_safetensors(path, tensors, metadata)


def load_checkpoint(path: Path, run: Training, configuration: str) -> None:
    """Continue `run`, freshly started, where the checkpoint stands."""
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    check_same(path, json.loads(metadata["configuration"]), json.loads(configuration))
    run.weights.set(tensors["weights"])
    run.averaged = tensors["averaged"]
    state = {k.removeprefix(_OPTIMISER): v for k, v in tensors.items() if k.startswith(_OPTIMISER)}
    run.optimiser.state[run.weights.values] = state
    run.step = int(metadata["step"])
    run.history = json.loads(metadata["history"])


Entry = dict[str, float]
"""Of the history: step, mean training loss since the last entry, validation MSE, g^2."""


@dataclass
class Training:
    """A run: what a checkpoint holds."""

    network: ForceNetwork  # What is trained
    weights: FlatWeights  # Its weights in one array
    optimiser: torch.optim.Optimizer  # What changes them
    averaged: Tensor  # (P,) running average of the weights
    step: int = 0  # Steps that were taken
    history: list[Entry] = field(default_factory=list)  # Errors along the way
    chosen: str = "last step"  # Which weights are the result, once training has ended


def to_batch(rows: InteractionRows, dtype: torch.dtype = torch.float32) -> Batch:
    """Convert rows to the network's inputs."""
    environment = -np.concatenate([rows.position[:, 2:], rows.velocity], axis=1)
    return Batch(
        ego_type=torch.from_numpy(rows.ego_type),
        environment=torch.from_numpy(environment).to(dtype),
        pair=torch.from_numpy(rows.neighbor).to(dtype),
        pair_type=torch.from_numpy(rows.neighbor_type),
    )


def predict(network: ForceNetwork, batch: Batch, chunk: int = 65536, every: bool = False) -> Tensor:
    """Vertical force from the network, (R,) in gram-force, or `every` head, without gradient."""
    answer = network.heads if every else network
    with torch.no_grad():
        count = len(batch.ego_type)
        parts = [
            answer(Batch(*(values[start : start + chunk] for values in batch)))
            for start in range(0, count, chunk)
        ]
    return torch.cat(parts) if parts else torch.zeros(0)


def start(spec: DeepSetSpec, config: TrainConfig) -> Training:
    """Make a fresh run: seeded weights and optimiser."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = build(spec)
    weights = FlatWeights(network)
    hold_spectral_norms(weights.matrices(), config.max_spectral_norm, config.spectral)
    rate = config.learning_rate
    optimiser: torch.optim.Optimizer = torch.optim.Adam([weights.values], lr=rate)
    if config.optimiser == "soap":
        optimiser = Soap(weights, rate)
    first = weights.values.detach()
    return Training(network, weights, optimiser, first.clone())


def train(
    rows: InteractionRows,
    spec: DeepSetSpec,
    config: TrainConfig,
    checkpoint: Path | None = None,
    progress: bool = True,
    watch: Callable[[Entry], None] | None = None,
    taught: FloatArray | None = None,
    first: Tensor | None = None,
    name: str | None = None,
) -> Training:
    """Fit one network to the rows' vertical labels `force_g[:, 2]` by least squares.

    The rows' validation blocks are held out; their error is recorded at every checkpoint and
    chooses nothing. The result has the weights of the last step, or their running average
    (`average_share`).

    Args:
        rows: labels already free of whatever should not be learned.
        spec: the function to fit.
        config: how.
        checkpoint: file to continue from if it exists, and to write; None keeps none.
        progress: show a progress bar, which says `name`.
        watch: called with every new entry of the history.
        taught: (R,) vertical force, gram-force, to learn in place of the labels; errors are of the
            labels all the same.
        first: (P,) weights to start from; None for seeded ones.
        name: of the network.

    Raises:
        ValueError: the checkpoint belongs to another configuration, the rows cannot be split, or
            training diverged.
    """
    torch.set_num_threads(1)
    config = with_mode_defaults(config)
    run = start(spec, config)
    if first is not None:
        run.weights.set(first)
        run.averaged = first.clone()
    configuration = _configuration(rows, spec, config, taught)
    if checkpoint is not None and checkpoint.exists():
        load_checkpoint(checkpoint, run, configuration)
    examples, check = _split(rows, config, spec, taught)
    total = total_steps(config, len(examples.label))
    batches = batches_per_epoch(len(examples.label), config.batch_size)
    loss_sum, order = 0.0, None
    bar = tqdm(total=total, initial=run.step, disable=not progress, unit="step", desc=name)
    while run.step < total:
        place = run.step % batches
        if order is None or place == 0:
            order = shuffled(examples, config, run.step // batches)
        chosen = order.part(place * config.batch_size, (place + 1) * config.batch_size)
        loss_sum += _step(run, chosen, config, total)
        bar.update()
        if run.step % config.checkpoint_every == 0 or run.step == total:
            count = run.step % config.checkpoint_every or config.checkpoint_every
            entry = _judge(run, {"step": run.step, "loss": loss_sum / count}, check, config)
            bar.set_postfix({name: f"{value:.2f}" for name, value in entry.items()})
            loss_sum = 0.0
            if watch is not None:
                watch(entry)
            if checkpoint is not None:
                save_checkpoint(checkpoint, run, configuration)
    bar.close()
    run.weights.set(_candidate(run, config))
    run.chosen = _chosen(run, config)
    run.weights.release()
    return run


def total_steps(config: TrainConfig, rows: int) -> int:
    """Optimiser steps of a run on so many training rows."""
    if config.epochs is None:
        assert config.steps is not None  # `settled` gives one of them
        return config.steps
    return max(1, round(config.epochs * batches_per_epoch(rows, config.batch_size)))


def _configuration(
    rows: InteractionRows, spec: DeepSetSpec, config: TrainConfig, taught: FloatArray | None
) -> str:
    settings = {entry.name: getattr(config, entry.name) for entry in fields(TrainConfig)}
    digest = hashlib.sha256()  # of the split too: held-out rows must stay held out
    for name in ROW_ARRAYS:
        digest.update(np.ascontiguousarray(getattr(rows, name)).tobytes())
    if spec.torque and rows.torque is not None:
        digest.update(np.ascontiguousarray(rows.torque).tobytes())
    if taught is not None:
        digest.update(taught.tobytes())
    content = {"rows": digest.hexdigest(), "spec": asdict(spec), "training": settings}
    return json.dumps(content, sort_keys=True)


def _split(
    rows: InteractionRows, config: TrainConfig, spec: DeepSetSpec, taught: FloatArray | None
) -> tuple[Examples, tuple[Batch, Tensor]]:
    """What is trained on, and the validation blocks, which are held out."""
    torque, horizontal = spec.torque, spec.kind == "composed"
    training, held_out = rows.select(~rows.validation), rows.select(rows.validation)
    weight = type_weights(training, config.balance)
    if taught is not None:
        training = training.with_vertical_force(taught[~rows.validation])
    examples = Examples(to_batch(training), targets(training, torque, horizontal), weight)
    return examples, (to_batch(held_out), targets(held_out))


def type_weights(rows: InteractionRows, balance: float) -> Tensor:
    """Weight of each row's squared error, (R,) with mean 1; see `TrainConfig.balance`."""
    weight = np.ones(len(rows))
    for index in range(len(rows.types)):
        own = rows.ego_type == index
        if own.any():
            weight[own] = max(float(np.mean(rows.force_g[own, 2] ** 2)), 1e-6) ** -balance
    return torch.from_numpy(weight / weight.mean()).float()


def _step(run: Training, chosen: Examples, config: TrainConfig, total: int) -> float:
    """Take one step of the optimiser on a batch; returns the batch's MSE, g^2."""
    run.optimiser.param_groups[0]["lr"] = _rate(config, run.step / total)
    squared = (run.network.heads(chosen.batch) - chosen.label.reshape(len(chosen.label), -1)) ** 2
    loss = torch.mean(chosen.weight * squared.sum(dim=1))
    if config.slope_limit is not None:
        # A generator per step, so that a run continued from a checkpoint draws the same.
        rng = np.random.default_rng([config.seed, run.step, 1])
        inputs = random_inputs(len(run.network.spec.types), config.slope_inputs, 2, rng)
        inputs = inputs._replace(environment=inputs.environment.float(), pair=inputs.pair.float())
        loss = loss + config.slope_weight * slope_penalty(run.network, inputs, config.slope_limit)
    run.weights.clear_gradient()
    loss.backward()  # type: ignore[no-untyped-call]
    run.optimiser.step()
    run.weights.check_finite(run.step + 1, float(loss.detach()), config.learning_rate)
    hold_spectral_norms(run.weights.matrices(), config.max_spectral_norm, config.spectral)
    run.step += 1
    if config.average_share:
        # At first the average is shorter, or the first weights would count to the end.
        share = max(1.0 / (config.average_share * total), 1.0 / (1.0 + 0.3 * run.step))
        run.averaged.lerp_(run.weights.values.detach(), min(share, 1.0))
    return float(squared[:, 0].detach().mean())


def _rate(config: TrainConfig, done: float) -> float:
    """The optimiser's rate after a share of the steps."""
    if config.schedule == "constant":
        return config.learning_rate
    return 0.5 * config.learning_rate * (1.0 + math.cos(math.pi * done))


def _candidate(run: Training, config: TrainConfig) -> Tensor:
    """The weights as they would be the result now: (P,), within their spectral norms."""
    if not config.average_share:
        return run.weights.values.detach().clone()
    # A mean of clipped matrices is within the clip, the norm being convex; of exact ones not exact.
    averaged = run.averaged.clone()
    matrices = run.weights.matrices(averaged)
    hold_spectral_norms(matrices, config.max_spectral_norm, config.spectral)
    return averaged


def _judge(run: Training, entry: Entry, check: tuple[Batch, Tensor], config: TrainConfig) -> Entry:
    """Add the error of the candidate weights to an entry, and the entry to the history."""
    kept, (batch, label) = run.weights.values.detach().clone(), check
    run.weights.set(_candidate(run, config))
    entry["validation"] = float(torch.mean((predict(run.network, batch) - label) ** 2))
    run.weights.set(kept)
    run.history.append(entry)
    return entry


def _chosen(run: Training, config: TrainConfig) -> str:
    """Say which weights of a finished run are its result."""
    what = "running average of the weights" if config.average_share else "weights"
    if config.teachers:
        what = f"taught by {config.teachers} networks, {what}"
    return f"{what} at the last step; validation chose nothing"


def train_taught(
    rows: InteractionRows,
    spec: DeepSetSpec,
    config: TrainConfig,
    checkpoint: Path | None = None,
    progress: bool = True,
    watch: Callable[[Entry], None] | None = None,
) -> Training:
    """Train the teachers that the configuration asks for, and the network that learns from them.

    It starts from the weights of the last teacher. Teachers take `teacher_epochs`, draw from seeds
    of their own, and have checkpoints beside the network's (`teacher_checkpoint`), so that a killed
    run continues with the network it was at. Arguments and errors are those of `train`.
    """
    config = with_mode_defaults(config)
    if not config.teachers:
        return train(rows, spec, config, checkpoint, progress, watch)
    answers = np.zeros(len(rows))
    for number in range(1, config.teachers + 1):
        path = None if checkpoint is None else teacher_checkpoint(checkpoint, number)
        name = f"teacher {number} of {config.teachers}"
        own = teacher_config(config, number)
        run = train(rows, spec, own, path, progress, name=name)
        answer = predict if config.symmetry == "none" else symmetric_mean
        answers += answer(run.network, to_batch(rows)).double().numpy() / config.teachers
    first = torch.nn.utils.parameters_to_vector(run.network.parameters()).detach()
    return train(rows, spec, config, checkpoint, progress, watch, answers, first, "the network")


def teacher_checkpoint(checkpoint: Path, number: int) -> Path:
    """File that a teacher's training continues from; teachers count from 1."""
    return checkpoint.with_name(f"{checkpoint.stem}-teacher-{number}{checkpoint.suffix}")


def teacher_config(config: TrainConfig, number: int) -> TrainConfig:
    """How a teacher is trained: on labels alone, for `teacher_epochs`, from a seed of its own."""
    seed = int(np.random.SeedSequence([config.seed, number]).generate_state(1)[0])
    return dataclasses.replace(
        config, steps=None, epochs=config.teacher_epochs, seed=seed, teachers=0
    )


def symmetric_mean(network: ForceNetwork, batch: Batch) -> Tensor:
    """Vertical force from the network, (R,) gram-force, mean over the symmetries of the square."""
    total = torch.zeros(len(batch.ego_type))
    for x, y, swap in itertools.product((1.0, -1.0), (1.0, -1.0), (False, True)):
        turn = square_symmetry(torch.tensor([x]), torch.tensor([y]), torch.tensor([swap]))
        total += predict(network, turned_rows(batch, turn.expand(len(total), 2, 2)))
    return total / 8.0
