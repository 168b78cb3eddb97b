"""The training of a network on rows.

A run that is killed continues from its checkpoint and ends with the same weights. A checkpoint is
a safetensors file of weights, Adam's moments and history.
"""

from __future__ import annotations

import hashlib
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

from swarm_envs.training.force_model.composed import build
from swarm_envs.training.force_model.examples import (
    Examples,
    batches_per_epoch,
    shuffled,
    targets,
)
from swarm_envs.training.force_model.export import write_safetensors
from swarm_envs.training.force_model.force_fit_config import TrainConfig as TrainConfig
from swarm_envs.training.force_model.network import Batch, DeepSetSpec, ForceNetwork
from swarm_envs.training.force_model.spectral import hold_spectral_norms
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.rows import ROW_ARRAYS
from swarm_envs.training.provenance import check_same

CHECKPOINT_STEPS = 500  # between checkpoints, and validation errors

Entry = dict[str, float]
"""Entry of the history: step, mean training loss since the last entry, validation MSE, g^2."""


@dataclass
class Training:
    """A run: what a checkpoint holds."""

    network: ForceNetwork  # What is trained
    optimizer: torch.optim.Adam  # What changes its weights
    step: int = 0  # Steps that were taken
    history: list[Entry] = field(default_factory=list)  # Errors along the way


def train(
    rows: InteractionRows,
    spec: DeepSetSpec,
    config: TrainConfig,
    checkpoint: Path | None = None,
    progress: bool = True,
    watch: Callable[[Entry], None] | None = None,
) -> Training:
    """Fit a network to the rows' vertical labels `force_g[:, 2]` by least squares, with Adam.

    The rows' validation blocks are held out; their error is recorded at every checkpoint and
    chooses nothing. The result has the weights of the last step.

    Args:
        rows: labels already free of whatever should not be learned.
        spec: the function to fit.
        config: how.
        checkpoint: file to continue from if it exists, and to write; None keeps none.
        progress: show a progress bar.
        watch: called with every new entry of the history.

    Raises:
        ValueError: the checkpoint belongs to another configuration, or training diverged.
    """
    torch.set_num_threads(1)
    run = start(spec, config)
    configuration = _configuration(rows, spec, config)
    if checkpoint is not None and checkpoint.exists():
        load_checkpoint(checkpoint, run, configuration)
    training, held_out = rows.select(~rows.validation), rows.select(rows.validation)
    examples, check = make_examples(training, spec, config.balance), to_batch(held_out)
    batches, losses, order = batches_per_epoch(len(training), config.batch_size), [], None
    bar = tqdm(total=config.steps, initial=run.step, disable=not progress, unit="step")
    while run.step < config.steps:
        epoch, place = divmod(run.step, batches)
        if order is None or place == 0:
            order = shuffled(examples, [config.seed, epoch], turn=spec.kind == "deep-set")
        chosen = order.part(place * config.batch_size, (place + 1) * config.batch_size)
        losses.append(take_step(run, chosen, config))
        bar.update()
        if run.step % CHECKPOINT_STEPS == 0 or run.step == config.steps:
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
            if watch is not None:
                watch(run.history[-1])
            if checkpoint is not None:
                save_checkpoint(checkpoint, run, configuration)
    bar.close()
    return run


def start(spec: DeepSetSpec, config: TrainConfig) -> Training:
    """Make a fresh run: seeded weights and optimizer."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = build(spec)
    hold_spectral_norms(network.parameters(), config.max_spectral_norm, config.spectral)
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)  # of a pair of types that a batch may lack
    optimizer = torch.optim.Adam(network.parameters(), lr=config.learning_rate, foreach=True)
    return Training(network, optimizer)


def take_step(run: Training, chosen: Examples, config: TrainConfig) -> float:
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
            f"training diverged: step {run.step} left weights that are not finite, at loss "
            f"{float(loss.detach()):g} and learning_rate {config.learning_rate:g}; give a lower "
            "learning_rate, and look for labels far from all others"
        )
    hold_spectral_norms(run.network.parameters(), config.max_spectral_norm, config.spectral)
    return float(squared[:, 0].detach().mean())


def make_examples(rows: InteractionRows, spec: DeepSetSpec, balance: float) -> Examples:
    """Return inputs and labels of training rows, with the weights of their errors."""
    label = targets(rows, spec.torque, horizontal=spec.kind == "composed")
    return Examples(to_batch(rows), label, type_weights(rows, balance))


def type_weights(rows: InteractionRows, balance: float) -> Tensor:
    """Return the weight of each row's squared error, (R,), mean 1; see `TrainConfig.balance`."""
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


_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # Adam's state of a parameter


def save_checkpoint(path: Path, run: Training, configuration: str) -> None:
    """Write everything that `load_checkpoint` needs; only the same `configuration` may continue."""
    tensors: dict[str, Tensor] = {}
    for name, parameter in run.network.named_parameters():
        state = run.optimizer.state[parameter]
        tensors[name] = parameter.detach()
        tensors |= {f"{moment} of {name}": state[moment] for moment in _MOMENTS}
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
        check_same(path, json.loads(metadata["configuration"]), json.loads(configuration))
        for name, parameter in run.network.named_parameters():
            parameter.data.copy_(file.get_tensor(name))
            run.optimizer.state[parameter] = {
                moment: file.get_tensor(f"{moment} of {name}") for moment in _MOMENTS
            }
    run.step = int(metadata["step"])
    run.history = json.loads(metadata["history"])


def _configuration(rows: InteractionRows, spec: DeepSetSpec, config: TrainConfig) -> str:
    """Return what a checkpoint must agree in, as JSON."""
    settings = {entry.name: getattr(config, entry.name) for entry in fields(TrainConfig)}
    digest = hashlib.sha256()  # of the split too: held-out rows must stay held out
    for name in ROW_ARRAYS:
        digest.update(np.ascontiguousarray(getattr(rows, name)).tobytes())
    if spec.torque and rows.torque is not None:
        digest.update(np.ascontiguousarray(rows.torque).tobytes())
    content = {"rows": digest.hexdigest(), "spec": asdict(spec), "training": settings}
    return json.dumps(content, sort_keys=True)
