"""The example that betters a swap by gradient descent."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
import torch

from examples import swap_by_gradient as example


def test_gradients_are_finite_differences() -> None:
    """Along a random direction, to which each of them contributes."""
    rng, dt, h = np.random.default_rng(0), 1.0 / 30.0, 1e-7
    sizes = torch.tensor(rng.normal(0.0, 0.02, example.BUMPS), requires_grad=True)

    def loss(sizes: torch.Tensor) -> torch.Tensor:
        return ((100.0 * example.height_errors(sizes, dt)) ** 2).mean()

    loss(sizes).backward()
    with torch.no_grad():
        way = torch.tensor(rng.normal(size=example.BUMPS))
        difference = (loss(sizes + h * way) - loss(sizes - h * way)) / (2.0 * h)
    assert sizes.grad is not None
    assert float(sizes.grad @ way) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.slow
def test_set_points_alone_hold_the_small_drone_within_5_cm() -> None:
    before, after = example.main(rounds=4, dt=1.0 / 80.0)
    assert before == pytest.approx(15.0, abs=1.0)  # as docs/limits.md has it
    assert after < 5.0
