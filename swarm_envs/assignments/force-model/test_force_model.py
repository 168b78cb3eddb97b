"""Run with `pytest`: checks that the model can be graded. Points need more than this."""

from types import SimpleNamespace

import numpy as np
from force_model import MyModel


def test_it_learns_that_a_drone_above_pushes_down():
    rng = np.random.default_rng(0)
    offset = rng.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 0.6), (200, 1, 3))
    near = np.exp(-np.sum(offset[..., :2] ** 2, axis=2) / 0.1**2)
    rows = SimpleNamespace(
        neighbor=np.concatenate([offset, np.zeros((200, 1, 3))], axis=2),
        neighbor_type=np.zeros((200, 1), dtype=int),
        force_g=np.concatenate([np.zeros((200, 2)), -8.0 * near], axis=1),
        types=("S",),
    )
    model = MyModel()
    model.fit(rows)
    predicted = model.predict(rows)
    assert predicted.shape == (200,)
    assert np.isfinite(predicted).all()
    assert predicted.mean() < 0.0
