"""SOAP, against Adam where they are the same, and by the symmetry that only SOAP has."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from swarm_envs.training.force_model.optimisers import FlatWeights, Soap

RATE = 1e-2


def moved(matrix_gradients: list[torch.Tensor]) -> torch.Tensor:
    """How far the matrix of a layer goes under given gradients, but for the first step."""
    rows, columns = matrix_gradients[0].shape
    network = nn.Sequential(nn.Linear(columns, rows, bias=False), nn.Linear(2, 7, bias=False))
    weights = FlatWeights(network)
    optimiser, after_first = Soap(weights, RATE), torch.zeros(0)
    for gradient in matrix_gradients:
        assert weights.values.grad is not None
        weights.clear_gradient()
        weights.values.grad[: gradient.numel()] = gradient.reshape(-1)
        optimiser.step()
        if not len(after_first):
            after_first = weights.matrices()[0].clone()
    return weights.matrices()[0] - after_first


def test_biases_get_plain_adam() -> None:
    network = nn.Linear(3, 4)
    weights = FlatWeights(network)
    alone = nn.Parameter(network.bias.detach().clone())
    optimiser, adam = Soap(weights, RATE), torch.optim.Adam([alone], lr=RATE)
    rng = np.random.default_rng(1)
    for _ in range(25):
        gradient = torch.from_numpy(rng.normal(size=16)).float()
        assert weights.values.grad is not None
        weights.values.grad.copy_(gradient)
        alone.grad = gradient[12:].clone()
        optimiser.step()
        adam.step()
    assert torch.allclose(network.bias, alone, atol=1e-6)


def published_moves(gradients: list[np.ndarray]) -> list[np.ndarray]:
    """Algorithm 3 of the paper for one matrix, in float64 and without padding."""
    left, right = gradients[0] @ gradients[0].T, gradients[0].T @ gradients[0]
    turn_left, turn_right = (np.linalg.eigh(s)[1][:, ::-1] for s in (left, right))
    mean, square, moves = np.zeros_like(left), np.zeros_like(left), []
    for step, gradient in enumerate(gradients, start=1):
        if step > 1:
            left = 0.98 * left + 0.02 * gradient @ gradient.T
            right = 0.98 * right + 0.02 * gradient.T @ gradient
        if step % 10 == 0:
            turn_left = np.linalg.qr(left @ turn_left)[0]
            turn_right = np.linalg.qr(right @ turn_right)[0]
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * (turn_left.T @ gradient @ turn_right) ** 2
        turned = turn_left.T @ (mean / (1 - 0.9**step)) @ turn_right
        scaled = turned / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
        moves.append(-RATE * turn_left @ scaled @ turn_right.T)
    return moves


def test_matrices_move_as_published() -> None:
    rng = np.random.default_rng(2)
    gradients = [rng.normal(size=(5, 5)) for _ in range(25)]
    found = moved([torch.from_numpy(g).float() for g in gradients])
    wanted = np.sum(published_moves(gradients)[1:], axis=0)
    assert found.numpy() == pytest.approx(wanted, abs=1e-3 * float(np.linalg.norm(wanted)))


@pytest.mark.parametrize("failure", ["silent", "raised"])
@pytest.mark.parametrize("failing", [{torch.float32}, {torch.float32, torch.float64}])
def test_what_lapack_cannot_do_stops_no_step(
    monkeypatch: pytest.MonkeyPatch, failure: str, failing: set[torch.dtype]
) -> None:
    """Its failures as they were seen, on every processor: NaN for eigenvectors, or an error."""
    solve = torch.linalg.eigh

    def failing_solve(matrices: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        values, vectors = solve(matrices)
        if matrices.dtype not in failing:
            return values, vectors
        if failure == "raised":
            raise torch.linalg.LinAlgError("it failed")  # type: ignore[attr-defined]
        vectors[0, :, -2:] = torch.nan
        return values, vectors

    rng = np.random.default_rng(3)
    gradients = [torch.from_numpy(rng.normal(size=(5, 5))).float() for _ in range(25)]
    sound = moved(gradients)
    monkeypatch.setattr(torch.linalg, "eigh", failing_solve)
    found = moved(gradients)
    assert torch.isfinite(found).all()
    if torch.float64 in failing:  # Adam until the basis is turned: as long a way, not the same
        assert 0.5 < float(found.norm() / sound.norm()) < 2.0
    else:
        assert torch.allclose(found, sound, atol=1e-3 * float(sound.norm()))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_weights_that_are_not_finite_end_the_fit(value: float) -> None:
    weights = FlatWeights(nn.Linear(3, 2))
    weights.check_finite(7, 2.5, 0.1)
    assert weights.values.grad is not None
    weights.values.grad[4] = value
    Soap(weights, RATE).step()
    said = r"diverged: step 7 left .* at loss 2\.5 and learning_rate 0\.1; give a lower"
    with pytest.raises(ValueError, match=said):
        weights.check_finite(7, 2.5, 0.1)
