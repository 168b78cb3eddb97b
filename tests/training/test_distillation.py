"""Distillation: what teachers may see, what they teach, and that a killed run goes on."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model import train as module
from swarm_envs.training.force_model.force_fit_config import FitConfig, TrainConfig
from swarm_envs.training.force_model.network import DeepSet
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.train import (
    Training,
    predict,
    symmetric_mean,
    teacher_checkpoint,
    teacher_config,
    to_batch,
    train,
    train_taught,
)
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from tests.helpers.tiny_fits import SPEC, rows_of

TAUGHT = TrainConfig(
    epochs=2.0,
    teachers=2,
    teacher_epochs=2.0,
    optimiser="soap",
    schedule="constant",
    average_share=0.2,
    batch_size=64,
    checkpoint_every=10,
    slope_limit=None,
    position_jitter_m=0.0,
    velocity_jitter=0.0,
    balance=0.0,
)


def vector(run: Training) -> torch.Tensor:
    return torch.nn.utils.parameters_to_vector(run.network.parameters()).detach()


def other_labels(rows: InteractionRows, changed: np.ndarray) -> InteractionRows:
    return rows.with_vertical_force(np.where(changed, 30.0, rows.force_g[:, 2]))


def test_the_mean_over_symmetries_is_symmetric() -> None:
    torch.manual_seed(0)
    network, rows = DeepSet(SPEC), rows_of(50, flights=1)
    with torch.no_grad():
        for weight in network.parameters():
            weight.mul_(3.0)  # or it hardly depends on its inputs
    found = symmetric_mean(network, to_batch(rows))
    assert not torch.allclose(found, predict(network, to_batch(rows)), atol=0.01)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    both = np.kron(np.eye(2), quarter)
    turned = dataclasses.replace(
        rows, velocity=rows.velocity @ quarter.T, neighbor=rows.neighbor @ both.T
    )
    assert torch.allclose(found, symmetric_mean(network, to_batch(turned)), rtol=1e-4)


def test_the_network_learns_what_teachers_say() -> None:
    rows = rows_of(1000, flights=1)
    config = dataclasses.replace(TAUGHT, teachers=1, epochs=60.0, teacher_epochs=3.0)
    teacher = train(rows, SPEC, teacher_config(config, 1), progress=False)
    taught = train_taught(rows, SPEC, config, progress=False)
    told = symmetric_mean(teacher.network, to_batch(rows)).numpy()
    training = ~rows.validation
    answer = predict(taught.network, to_batch(rows)).numpy()
    own = predict(teacher.network, to_batch(rows)).numpy()
    from_lesson = np.mean((answer - told)[training] ** 2)
    assert from_lesson < 0.5 * np.mean((own - told)[training] ** 2)
    assert from_lesson < 0.5 * np.mean((answer - rows.force_g[:, 2])[training] ** 2)
    error = np.mean((answer - rows.force_g[:, 2])[rows.validation] ** 2)
    assert taught.history[-1]["validation"] == pytest.approx(error, rel=1e-3)
    assert "taught by 1 network" in taught.chosen


def test_held_out_rows_teach_nobody() -> None:
    rows = rows_of(1000, flights=1)
    first = train_taught(rows, SPEC, TAUGHT, progress=False)
    again = train_taught(other_labels(rows, rows.validation), SPEC, TAUGHT, progress=False)
    assert torch.equal(vector(first), vector(again))


@pytest.mark.parametrize(("killed_at", "left"), [(5, 78), (40, 42), (65, 16)])
def test_killed_run_goes_on_with_the_network_it_was_at(
    killed_at: int, left: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, path = rows_of(1000, flights=1), tmp_path / "checkpoint.safetensors"
    config = dataclasses.replace(TAUGHT, slope_limit=50.0, slope_inputs=16, position_jitter_m=0.02)
    whole = train_taught(rows, SPEC, config, progress=False)
    step, calls = module._step, []

    def dying_step(*arguments: object) -> float:
        calls.append(1)
        if len(calls) == killed_at:
            raise KeyboardInterrupt
        return step(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "_step", dying_step)
    with pytest.raises(KeyboardInterrupt):
        train_taught(rows, SPEC, config, path, progress=False)
    resumed = train_taught(rows, SPEC, config, path, progress=False)
    assert torch.equal(vector(whole), vector(resumed))
    assert resumed.history == whole.history
    assert len(calls) == killed_at + left  # of 26 steps for each of three networks
    assert teacher_checkpoint(path, 1).exists()


def test_fit_records_its_teachers_and_removes_their_checkpoints(tmp_path: Path) -> None:
    save_rows(tmp_path / "rows.npz", rows_of(1000, flights=1))
    config = FitConfig(data=tmp_path / "rows.npz", out=tmp_path / "out", mode="measured",
                       epochs=1.0, teachers=1, teacher_epochs=1.0, lipschitz_samples=0,
                       progress=False)  # fmt: skip
    fit(config)
    assert sorted(p.name for p in config.out.iterdir()) == ["learned.json", "learned.safetensors"]
    written = json.loads((config.out / "learned.json").read_text())
    assert (written["config"]["optimiser"], written["config"]["teachers"]) == ("soap", 1)
    assert "taught by 1 network" in written["chosen"]
