"""The training loop: passes, symmetries, spectral norms, and what held-out rows may do."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model.examples import (
    Examples,
    shuffled,
    square_symmetries,
    turned_rows,
)
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.spectral import hold_spectral_norms
from swarm_envs.training.force_model.train import Training, to_batch, train
from tests.helpers.tiny_fits import PLAIN, SPEC, rows_of
from tests.helpers.torch_swarms import swarm_batch


def norms(network):
    return [np.linalg.norm(p.detach().numpy(), 2) for p in network.parameters() if p.ndim == 2]


def test_a_pass_takes_every_row_once_in_an_order_of_its_own():
    rows = rows_of(300)
    batch = to_batch(rows)
    examples = Examples(batch, torch.arange(300.0), torch.ones(300))
    first, second, again = (shuffled(examples, [0, epoch], turn=False) for epoch in (0, 1, 0))
    assert torch.equal(first.label.sort().values, examples.label)
    assert not torch.equal(first.label, second.label)
    assert torch.equal(first.label, again.label)
    order = first.label.long()
    for shuffled_values, values in zip(first.batch, batch, strict=True):
        assert torch.equal(shuffled_values, values[order])


def test_random_turns_keep_what_does_not_depend_on_direction():
    examples = Examples(to_batch(rows_of(200)), torch.arange(200.0), torch.ones(200))
    moved = shuffled(examples, [0, 0], turn=True)
    order = moved.label.long()
    old, new = examples.batch.pair[order, 0], moved.batch.pair[:, 0]
    assert torch.equal(old[:, [2, 5]], new[:, [2, 5]])
    assert torch.allclose(old[:, :2].norm(dim=1), new[:, :2].norm(dim=1), atol=1e-6)
    before, after = ((x[:, :2] * x[:, 3:5]).sum(1) for x in (old, new))
    assert torch.allclose(before, after, atol=1e-6)
    own = [b[:, 1:3] for b in (examples.batch.environment[order], moved.batch.environment)]
    before, after = ((x[:, :2] * v).sum(1) for x, v in zip((old, new), own, strict=True))
    assert torch.allclose(before, after, atol=1e-6)  # drone and neighbour turn together
    assert not torch.allclose(old, new)


def test_a_turn_is_counterclockwise():
    position = torch.tensor([[[0.0, 0.0, 1.0], [1.0, 0.0, 1.5]]])
    velocity = torch.tensor([[[0.2, 0.0, 0.1], [0.0, 0.3, 0.0]]])
    quarter = torch.tensor([[0.0, -1.0], [1.0, 0.0]]).expand(2, 2, 2)
    batch = turned_rows(swarm_batch(position, velocity, [0, 0]), quarter)
    expected = torch.tensor([0.0, 1.0, 0.5, -0.3, -0.2, -0.1])
    assert torch.allclose(batch.pair[0, 0], expected, atol=1e-6)
    assert torch.allclose(batch.environment[0], -torch.tensor([1.0, 0.0, 0.2, 0.1]), atol=1e-6)


def test_symmetries_of_the_square_are_eight_orthogonal_matrices():
    drawn = torch.tensor([[0, 0, 0, 0, 1, 1, 1, 1], [0, 0, 1, 1, 0, 0, 1, 1], [0, 1] * 4])
    turns = square_symmetries(drawn)
    assert torch.equal(turns @ turns.mT, torch.eye(2).expand(8, 2, 2))
    assert len(torch.unique(turns.reshape(8, 4), dim=0)) == 8


def test_exact_normalization_gives_every_matrix_the_norm():
    config = dataclasses.replace(PLAIN, spectral="exact", max_spectral_norm=1.7)
    run = train(rows_of(), SPEC, config)
    assert norms(run.network) == pytest.approx([1.7] * 20, rel=1e-5)
    free = train(rows_of(), SPEC, dataclasses.replace(config, spectral="none"))
    assert np.ptp(norms(free.network)) > 0.1


def test_zero_matrix_cannot_be_normalised_exactly():
    with pytest.raises(ValueError, match="shape \\(2, 3\\) is zero"):
        hold_spectral_norms([torch.zeros(2, 3)], 1.0, "exact")
    hold_spectral_norms([torch.zeros(2, 3)], 1.0, "clip")


def vector(run: Training) -> torch.Tensor:
    return torch.nn.utils.parameters_to_vector(run.network.parameters()).detach()


def test_held_out_rows_teach_nothing() -> None:
    rows = rows_of(1000, flights=1)
    first = train(rows, SPEC, PLAIN)
    other = rows.with_vertical_force(np.where(rows.validation, 30.0, rows.force_g[:, 2]))
    again = train(other, SPEC, PLAIN)
    assert torch.equal(vector(first), vector(again))
    assert first.history != again.history


def test_labels_that_are_too_large_end_a_training_that_diverges() -> None:
    rows = rows_of(1000)
    far = rows.with_vertical_force(1e38 * rows.force_g[:, 2])
    said = r"diverged: after step \d+ weights .* learning_rate 0\.003; give"
    with pytest.raises(ValueError, match=said):
        train(far, SPEC, dataclasses.replace(PLAIN, steps=400))


def test_a_composed_model_is_not_fitted_to_labels_as_measured(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="use it with --mode anchored"):
        FitConfig(data=tmp_path, out=tmp_path, model="composed", mode="measured")
