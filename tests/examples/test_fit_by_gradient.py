"""The example that fits a wake through flights."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
import torch

from examples import fit_by_gradient as example


def test_gradients_are_finite_differences() -> None:
    rng, seconds, dt, h = np.random.default_rng(1), 0.6, 1.0 / 60.0, 1e-7
    truth = torch.tensor(example.TRUTH, dtype=torch.float64)
    factors = torch.tensor([0.9, 1.05], dtype=torch.float64, requires_grad=True)
    recorded = example.simulated(truth, seconds, dt)
    example.misfit(factors, recorded, seconds, dt).backward()
    with torch.no_grad():
        for _ in range(2):
            way = torch.tensor(rng.normal(size=2))
            up, down = (
                example.misfit(factors + sign * h * way, recorded, seconds, dt)
                for sign in (1.0, -1.0)
            )
            expected = float((up - down) / (2.0 * h))
            assert factors.grad is not None
            assert float(factors.grad @ way) == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
def test_the_fit_finds_strength_and_width_to_5_percent() -> None:
    assert example.main(seconds=0.8) == pytest.approx(example.TRUTH, rel=0.05)
