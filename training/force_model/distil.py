"""Distillation: a network that learns from the mean of others, trained before it on the same rows.

Labels are noisy, and a network of this size has learned some of the noise before it has learned
the force. The mean of a few such networks has less of both kinds of error than each of them, and
the mean over the symmetries of the square less again. One network of the same size can learn it
(Hinton et al. 2015, arXiv:1503.02531). Held-out rows teach nobody.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from swarm_envs.training.force_model.config import TrainConfig, settled
from swarm_envs.training.force_model.early import inner_split
from swarm_envs.training.force_model.epochs import transform
from swarm_envs.training.force_model.network import Batch, DeepSetSpec, ForceNetwork
from swarm_envs.training.force_model.train import Entry, Lesson, Training, predict, to_batch, train
from swarm_envs.training.interaction_rows import InteractionRows


def train_taught(
    rows: InteractionRows,
    spec: DeepSetSpec,
    config: TrainConfig,
    checkpoint: Path | None = None,
    progress: bool = True,
    watch: Callable[[Entry], None] | None = None,
) -> Training:
    """Train the teachers that the configuration asks for, and the network that learns from them.

    It starts from the weights of the last teacher.

    Args:
        rows: as `train`.
        spec: the function to fit; teachers have the same.
        config: how. Teachers take `teacher_epochs` and draw from seeds of their own.
        checkpoint: as `train`; teachers have files beside it (`teacher_checkpoint`), so that a
            run that was killed goes on with the network it was at.
        progress: show a progress bar, which says which network trains.
        watch: called with every new entry of the history of the network that is the result.

    Raises:
        ValueError: a checkpoint belongs to another configuration, or the rows cannot be split.
    """
    config = settled(config)
    if not config.teachers:
        return train(rows, spec, config, checkpoint, progress, watch)
    answers = np.zeros(len(rows))
    for number in range(1, config.teachers + 1):
        path = None if checkpoint is None else teacher_checkpoint(checkpoint, number)
        name = f"teacher {number} of {config.teachers}"
        told = teacher_config(config, number)
        run = train(_for_teachers(rows, config), spec, told, path, progress, name=name)
        answers += symmetric_mean(run.network, to_batch(rows)).double().numpy() / config.teachers
    taught = config.label_share * rows.force_g[:, 2] + (1.0 - config.label_share) * answers
    first = torch.nn.utils.parameters_to_vector(run.network.parameters()).detach()
    lesson = Lesson(taught, first)
    return train(rows, spec, config, checkpoint, progress, watch, lesson, "the network")


def teacher_checkpoint(checkpoint: Path, number: int) -> Path:
    """File that a teacher's training continues from; teachers count from 1."""
    return checkpoint.with_name(f"{checkpoint.stem}-teacher-{number}{checkpoint.suffix}")


def teacher_config(config: TrainConfig, number: int) -> TrainConfig:
    """How a teacher is trained: on labels alone, for `teacher_epochs`, from a seed of its own."""
    seed = int(np.random.SeedSequence([config.seed, number]).generate_state(1)[0])
    return dataclasses.replace(
        config,
        steps=None,
        epochs=config.teacher_epochs,
        seed=seed,
        teachers=0,
        early_validation=0.0,
    )


def symmetric_mean(network: ForceNetwork, batch: Batch) -> Tensor:
    """Vertical force from the network, (R,) gram-force, mean over the symmetries of the square."""
    total, count = torch.zeros(len(batch.ego_type)), len(batch.ego_type)
    for sign_x, sign_y, swap in itertools.product((1.0, -1.0), (1.0, -1.0), (False, True)):
        mirror_x, mirror_y = torch.full((count,), sign_x), torch.full((count,), sign_y)
        total += predict(network, transform(batch, mirror_x, mirror_y, torch.full((count,), swap)))
    return total / 8.0


def _for_teachers(rows: InteractionRows, config: TrainConfig) -> InteractionRows:
    """The rows with those of early validation held out from the teachers, too."""
    if not config.early_validation:
        return rows
    training, _ = inner_split(rows, config.early_validation, config.seed, config.early_held)
    return dataclasses.replace(rows, validation=~training)
